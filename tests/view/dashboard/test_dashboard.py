"""The dashboard of a running robot, used as people do: in a browser."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

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


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Return a robot of this test alone: a counter and a printer."""
    text = (_HELLO / "robot.yaml").read_text()
    file = tmp_path / "robot.yaml"
    file.write_text(text.replace("robot: hello", f"robot: dashboard-{os.getpid()}"))
    shutil.copy(_HELLO / "hello.py", tmp_path)
    return file


@pytest.fixture
def address() -> Iterator[str]:
    """Start a dashboard, and return where it is."""
    pytest.importorskip("nicegui")
    # else NiceGUI takes the server for a test of its own
    others = {k: v for k, v in os.environ.items() if k != "PYTEST_CURRENT_TEST"}
    words = ("dashboard", f"dashboard-{os.getpid()}", "--port", "0")
    with subprocess.Popen(
        [*POISE, *words], stdout=subprocess.PIPE, text=True, env=others
    ) as server:
        assert server.stdout is not None
        try:
            line = server.stdout.readline()
            assert "http://" in line
            yield line.split()[4].rstrip(";")
        finally:
            server.terminate()
            server.communicate(timeout=LONG)


@pytest.fixture
def page(address: str) -> Iterator[Any]:
    """Return a browser's page that shows the dashboard; it may complain of nothing."""
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
            "console", lambda m: said.append(m.text) if m.type == "error" else None
        )
        found.goto(address)
        yield found
        browser.close()
    assert not said


def on(page: Any, computer: str, component: str) -> Any:
    """Return a component's box on a computer."""
    return page.locator(f'[data-computer="{computer}"] [data-component="{component}"]')


def test_shows_a_robot_asks_what_if_moves_undoes_and_survives_its_manager(
    robot: Path, page: Any
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    name = f"dashboard-{os.getpid()}"
    with robot_up(robot):
        on(page, "left", "counter").wait_for()
        on(page, "right", "printer").wait_for()
        page.get_by_role("cell", name="counter.tick").wait_for()
        page.get_by_text("everything runs").first.wait_for()

        # what if, by dragging; nothing happens
        printer = on(page, "right", "printer")
        printer.drag_to(page.locator('[data-computer="left"]'))
        page.get_by_text("Move printer to left?").wait_for()
        page.get_by_text("core-seconds").wait_for()
        page.get_by_role("button", name="Cancel").click()
        page.wait_for_selector(".q-dialog", state="detached")
        on(page, "right", "printer").wait_for()

        # what if, by keyboard; do it, and undo it
        printer.press("Enter")
        page.get_by_role("button", name="left", exact=True).press("Enter")
        page.get_by_role("button", name="Do it").click()
        on(page, "left", "printer").wait_for()
        page.get_by_role("button", name="Undo: printer back to right").click()
        on(page, "right", "printer").wait_for()

        # it follows what is done elsewhere
        assert run_poise("move", "printer", "left", "--robot", name).returncode == 0
        on(page, "left", "printer").wait_for()

        page.get_by_role("button", name="moved component").first.click()
        page.get_by_role("button", name="Close").click()
        page.wait_for_selector(".q-dialog", state="detached")
        found = axe.Axe().run(page).response["violations"]
        assert [v["id"] for v in found if v["impact"] in {"serious", "critical"}] == []
    page.get_by_text("No answer since").wait_for()
    with robot_up(robot):
        wait_long(lambda: not page.get_by_text("No answer since").count())
        on(page, "right", "printer").wait_for()
