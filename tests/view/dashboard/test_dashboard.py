"""The dashboard of a running robot, used as people do: in a browser."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from msgspec.structs import replace

from benchmarks.dashboard import FRAMES
from benchmarks.synthetic import statuses
from benchmarks.synthetic.slow_link import SlowLink
from benchmarks.synthetic.statuses import told
from poise.manage.control_socket.commands import RobotStatus, StatusCommand
from poise.session.keys import init_keys
from tests.command import POISE, robot_up, run_poise
from tests.waiting import LONG, wait_long

_CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        _CHROMIUM is None, reason="no chromium to open it: apt-get install chromium"
    ),
]
_HELLO = Path("examples/hello").resolve()
_MS = 1000 * LONG
_IN_TEST = "PYTEST_CURRENT_TEST"
"""Without it NiceGUI does not take the server for a test of its own."""
_NOT_OURS = "net::ERR_NETWORK_CHANGED"
"""Other tests emulate computers; the browser tries again, and says so."""
_SHOWN = "document.querySelectorAll('[data-component]').length"


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Return a robot of this test alone: a counter and a printer."""
    text = (_HELLO / "robot.yaml").read_text()
    file = tmp_path / "robot.yaml"
    file.write_text(text.replace("robot: hello", f"robot: dashboard-{os.getpid()}"))
    shutil.copy(_HELLO / "hello.py", tmp_path)
    return file


@contextlib.contextmanager
def dashboard(robot: str) -> Iterator[str]:
    """Start a dashboard, and yield where it is."""
    pytest.importorskip("nicegui")
    words = ("dashboard", robot, "--port", "0")
    with subprocess.Popen(
        [*POISE, *words], stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        try:
            yield address_in(server.stdout)
        finally:
            server.terminate()
            server.communicate(timeout=LONG)


def address_in(lines: Iterable[str]) -> str:
    """Return where a dashboard says that it is."""
    return next(line for line in lines if "http://" in line).split()[4].rstrip(";")


@pytest.fixture
def page() -> Iterator[Any]:
    """Return a browser's page; it may complain of nothing."""
    playwright = pytest.importorskip("playwright.sync_api")
    said: list[str] = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=_CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        found = browser.new_page()
        found.set_default_timeout(_MS)
        found.on("pageerror", lambda error: said.append(str(error)))
        found.on(
            "console",
            lambda m: (
                said.append(m.text)
                if m.type == "error" and _NOT_OURS not in m.text
                else None
            ),
        )
        yield found
        browser.close()
    assert not said


def on(page: Any, computer: str, component: str) -> Any:
    """Return a component's box on a computer."""
    return page.locator(f'[data-computer="{computer}"] [data-component="{component}"]')


def test_other_computers_need_an_address_that_says_what_they_may(
    robot: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(_IN_TEST)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    playwright = pytest.importorskip("playwright.sync_api")
    name = f"dashboard-{os.getpid()}"
    words = ("dashboard", name, "--host", "0.0.0.0", "--port", "0")
    refused = run_poise(*words)
    assert refused.returncode == 2
    assert "no keys of robot" in refused.stderr
    init_keys(name)
    with contextlib.ExitStack() as stack:
        stack.enter_context(robot_up(robot))
        server = stack.enter_context(
            subprocess.Popen([*POISE, *words], stdout=subprocess.PIPE, text=True)
        )
        stack.callback(server.terminate)
        assert server.stdout is not None
        acts, looks = (
            next(word for word in line.split() if "https" in word)
            .rstrip(";")
            .replace("0.0.0.0", "127.0.0.1")
            for line in (server.stdout.readline(), server.stdout.readline())
        )
        driver = stack.enter_context(playwright.sync_playwright())
        browser = driver.chromium.launch(
            executable_path=_CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        stack.callback(browser.close)
        stops = {}
        for address in (acts, looks):
            page = browser.new_context(ignore_https_errors=True).new_page()
            page.set_default_timeout(_MS)
            page.goto(address)
            page.wait_for_selector("[data-component]")
            stops[address] = page.get_by_text("Stop robot").count()
        assert stops == {acts: 1, looks: 0}
        page.locator('[data-component="printer"]').click()
        page.get_by_role("dialog").get_by_role("button", name="left").click()
        page.get_by_role("button", name="Do it").click()
        page.get_by_text("this page is read-only").wait_for()


_STILL = """() => document.getAnimations().every(
  each =>
    each.playState !== "running" || each.effect.getTiming().iterations === Infinity
)"""


_LINES = """all => Math.max(...all.map(each => {
  const inside = document.createRange();
  inside.selectNodeContents(each);
  return inside.getClientRects().length;
}))"""
"""On how many lines a text is, at most: the time of a decision was on two."""


def test_shows_a_robot_its_log_asks_what_if_moves_and_undoes(
    robot: Path, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(_IN_TEST)
    pytest.importorskip("nicegui")
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    name = f"dashboard-{os.getpid()}"
    with robot_up(robot, "--dashboard") as up:
        assert up.stdout is not None
        page.goto(address_in(up.stdout))
        on(page, "left", "counter").wait_for()
        on(page, "right", "printer").wait_for()
        page.get_by_role("cell", name="counter.tick").wait_for()
        page.get_by_text("all components run").first.wait_for()

        # what if, by dragging; nothing happens
        printer = on(page, "right", "printer")
        printer.drag_to(page.locator('[data-computer="left"]'))
        page.get_by_text("Move printer to left?").wait_for()
        page.get_by_text("core-seconds").wait_for()
        page.get_by_role("button", name="Cancel", exact=True).click()
        page.wait_for_selector(".q-dialog", state="detached")
        on(page, "right", "printer").wait_for()

        # what if, by keyboard; do it, and undo it
        printer.press("Enter")
        page.get_by_text("printer has ").wait_for()  # its log
        page.get_by_role("button", name="left", exact=True).press("Enter")
        page.get_by_role("button", name="Do it").click()
        on(page, "left", "printer").wait_for()
        page.get_by_role("button", name="Undo: printer back to right").click()
        on(page, "right", "printer").wait_for()

        # it follows what is done elsewhere, and says what else there was
        assert run_poise("move", "printer", "left", "--robot", name).returncode == 0
        on(page, "left", "printer").wait_for()
        assert run_poise("balance", "--cost", "0", "--robot", name).returncode == 0
        in_time_line = page.locator('.moment[title^="asked to balance"]')
        in_list = page.locator(".entries button", has_text="asked to move 'printer'")
        # a busy machine may have more to say since
        page.locator("button.more", has_text="decisions").click()
        assert page.locator(".entries time").evaluate_all(_LINES) == 1
        for entry in in_time_line, in_list:
            entry.first.click()
            table = page.get_by_role("table").filter(has_text="cores too little")
            table.get_by_role("cell", name="stay").wait_for()
            assert table.get_by_role("cell", name="move").count()
            page.get_by_role("button", name="Close").click()
            page.wait_for_selector(".q-dialog", state="detached")

        # the tab says whose it is; a task is paused and goes on; how it was is drawn
        page.wait_for_function(f"document.title.includes('{name}')")
        page.get_by_role("button", name="pause task greet").click()
        page.get_by_role("button", name="resume task greet").click()
        page.get_by_role("button", name="cancel task greet").click()
        page.get_by_role("button", name="Cancel the task").click()
        page.locator(".tasks .cancelled").wait_for()
        assert "waits" not in page.locator(".tasks").inner_text()
        page.locator(".history .line").first.wait_for(state="attached")
        page.wait_for_function(_STILL)  # what fades has no colour of its own
        found = axe.Axe().run(page).response["violations"]
        assert [v for v in found if v["impact"] in {"serious", "critical"}] == []
        page.goto("about:blank")  # it would complain that the server has ended


@pytest.mark.exhaustive
def test_follows_managers_over_any_link_and_bears_200_components_and_ten_pages(
    page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manager only tells: of 200 components, all of whose figures change."""
    monkeypatch.delenv(_IN_TEST)
    name = f"many-{os.getpid()}"
    updates: list[str] = []

    def note(update: str) -> None:
        updates.append(update)

    page.on("websocket", lambda socket: socket.on("framereceived", note))
    with dashboard(name) as address, SlowLink(address) as link:
        page.goto(link.address)
        page.get_by_text("No answer since").wait_for()
        with told(name, 200) as asked:
            page.wait_for_function(f"{_SHOWN} === 200")
            # it draws on while all figures change: no picture takes so long
            assert page.evaluate(FRAMES, 1.0) > 1.0

            # nothing passes, and nothing queues: of all that changes the last is sent
            link.rate, link.delay = 0.0, 0.2
            had = asked[StatusCommand]
            wait_long(lambda: asked[StatusCommand] >= had + 10)
        updates.clear()
        link.rate = 12_500.0
        page.get_by_text("No answer since").wait_for()
        assert 0 < sum("show" in each for each in updates) < 8
        link.cut()
        with told(name, 5):
            page.wait_for_function(f"{_SHOWN} === 5")
            wait_long(lambda: not page.get_by_text("No answer since").count())
            page.locator("[data-component]").first.press("Enter")
            page.get_by_role("button", name="Close").click()
            others = [page.context.browser.new_page() for _ in range(9)]
            for each in others:
                each.goto(address, timeout=_MS)
            for each in others:
                each.wait_for_function(f"{_SHOWN} === 5", timeout=_MS)
                each.close()
        page.goto("about:blank")


def test_a_page_that_gets_no_news_calls_nothing_fine_and_acts_on_nothing(
    page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was clicked meanwhile would be done once the link is back."""
    monkeypatch.delenv(_IN_TEST)
    name = f"silent-{os.getpid()}"
    with dashboard(name) as address, SlowLink(address) as link:
        page.goto(link.address)
        page.get_by_text("No answer since").wait_for()
        assert not page.get_by_text("below is").count()  # nothing is
        with told(name, 2):
            page.locator(".health.good").wait_for()
            page.locator(".tasks").wait_for(state="attached")
            link.rate = 0.0
            page.get_by_text("Nothing has come for").wait_for()
            assert not page.locator(".health.good, .fine, .tasks").count()
        page.goto("about:blank")


def test_nothing_is_said_of_what_a_lost_computer_runs(
    page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(_IN_TEST)
    name, known = f"lost-{os.getpid()}", statuses.status

    def lost(robot: str, components: int, at: float, since: float) -> RobotStatus:
        status = known(robot, components, at, since)
        return replace(status, out_of_reach={"gone": since})

    monkeypatch.setattr(statuses, "status", lost)
    with dashboard(name) as address, told(name, 2):
        page.goto(address)
        box = page.locator('[data-computer="gone"]')
        box.get_by_text("how it is now is not known").wait_for()
        assert not box.get_by_text("no component runs here").count()
        page.goto("about:blank")


def test_long_names_fit_on_a_small_screen(
    robot: Path, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(_IN_TEST)
    pytest.importorskip("nicegui")
    long, other = "the_computer_at_the_right_of_the_robot", "t" + 62 * "o"
    text = robot.read_text().replace("right", long)
    actions = "{actions: [{name: greet, functions: [greeting]}]}"
    robot.write_text(f"{text}  {other}: {actions}\n")
    page.set_viewport_size({"width": 390, "height": 800})
    with robot_up(robot, "--dashboard") as up:
        assert up.stdout is not None
        page.goto(address_in(up.stdout))
        on(page, long, "printer").wait_for()
        page.get_by_text(f"start {other}").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        page.goto("about:blank")  # it would complain that the server has ended


def test_parameters_are_set_in_the_dialog_of_their_component(
    robot: Path, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(_IN_TEST)
    pytest.importorskip("nicegui")
    with (robot.parent / "hello.py").open("a") as code:
        code.write("""

class Steps(Message):
    step: int
    note: str


class Stepper(Counter):
    parameters: Steps

    def reconfigure(self, parameters: Steps) -> None:
        if parameters.step > 9:
            raise ValueError("too far")
""")
    note = f"{'what is long ' * 10}\nhas lines"
    stepper = f'"hello:Stepper", parameters: {{step: 2, note: {json.dumps(note)}}}'
    robot.write_text(robot.read_text().replace('"hello:Counter"', stepper))
    with robot_up(robot, "--dashboard") as up:
        assert up.stdout is not None
        page.goto(address_in(up.stdout))
        on(page, "left", "counter").wait_for()
        on(page, "left", "counter").press("Enter")
        assert yaml.safe_load(page.get_by_label("note").input_value()) == note
        field = page.get_by_label("step")
        for value, told in ("30", "too far"), ("3", "counter has step = 3"):
            field.fill(value)
            page.get_by_role("button", name="Set").click()
            page.get_by_text(told).first.wait_for()
        shown = run_poise(
            "param", "get", "counter", "--robot", f"dashboard-{os.getpid()}", "--json"
        )
        assert json.loads(shown.stdout) == {"step": 3, "note": note}
        page.goto("about:blank")  # it would complain that the server has ended
