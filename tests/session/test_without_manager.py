"""A robot whose manager was killed or stopped is found, watched, ended, taken over."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from msgspec.msgpack import encode

import poise
from poise.emulate import probe_host
from poise.errors import RunError, UsageError
from poise.manage.control_socket.agents_without_manager import NoManager
from poise.manage.control_socket.commands import StopReport
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.takeover import newest_record
from poise.session.running_robots import without_manager
from poise.session.running_robots.local_robots import listing, robots_here
from poise.view.robot_view import LiveReader
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.status_records import AgentStatus
from poise.wire.robots_here import AgentAddresses, folder, path_of
from tests.command import run_poise
from tests.waiting import LONG, wait_long

pytestmark = pytest.mark.slow

HELLO = Path(__file__).parents[2] / "examples" / "hello"
NAME = f"orphan{os.getpid()}"
COMMANDS = (
    ("move", "printer", "left"),
    ("move", "printer", "left", "--dry-run"),
    ("replace", "printer", "hello:Printer"),
    ("balance",),
    ("task", "list"),
    ("task", "start", "greet"),
    ("log",),
    ("echo", "counter.count"),
    ("param", "list"),
)
SENTENCE = rf"robot '{NAME}' runs without a manager \(since \d\d:\d\d:\d\d\); `poise up"


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the file of a robot that is up, with a manager in the background."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "hello.py").write_text((HELLO / "hello.py").read_text())
    file = tmp_path / "robot.yaml"
    text = (HELLO / "robot.yaml").read_text()
    file.write_text(text.replace("robot: hello", f"robot: {NAME}"))
    up(file)
    yield file
    run_poise("stop", "--robot", NAME)
    run_poise("emulate", "stop", "--robot", NAME)


def up(file: Path, *options: str) -> None:
    words = "up", "--detach", *options, file, "--placement", "round-robin"
    done = run_poise(*words)
    assert done.returncode == 0, done.stderr


def status() -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(
        run_poise("status", "--robot", NAME, "--json").stdout
    )
    return answer


def containers(answer: dict[str, Any]) -> set[int]:
    """Return the processes of all containers."""
    computers = answer["computers"].values()
    return {container["pid"] for each in computers for container in each["containers"]}


def kill_manager() -> dict[str, Any]:
    """Kill the manager; return the last status before."""
    before = status()
    os.kill(before["manager"]["pid"], signal.SIGKILL)

    def is_unmanaged() -> bool:
        computers = status().get("computers", {})  # an error while it is noticed
        return bool(computers) and all(c["unmanaged"] for c in computers.values())

    wait_long(is_unmanaged)
    return before


def says(pattern: str, text: str) -> None:
    assert re.search(pattern, text), text


@contextlib.contextmanager
def stopped(process: int) -> Iterator[None]:
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGCONT)


def test_every_command_says_that_a_robot_runs_without_a_manager(file: Path) -> None:
    before = kill_manager()
    after = status()
    assert after["by_agents"]
    assert after["placement"] == before["placement"]
    assert containers(after) == containers(before)
    assert after["manager"] == before["manager"]
    shown = run_poise("status", "--robot", NAME)
    assert shown.returncode == 4
    says(SENTENCE, shown.stdout)
    assert "everything is as the robot file says" not in shown.stdout
    for words in COMMANDS:
        done = run_poise(*words, "--robot", NAME)
        assert done.returncode == 4, (words, done.stderr)
        says(SENTENCE, done.stderr)
    failed = json.loads(run_poise("balance", "--robot", NAME, "--json").stdout)
    assert failed["kind"] == "NoManager"
    by_file = run_poise("status", "--file", file)
    assert by_file.returncode == 4
    says(SENTENCE, by_file.stdout)


@pytest.mark.usefixtures("file")
def test_a_recording_ends_whole_and_says_that_there_is_no_manager(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mcap", reason="mcap is not installed")
    kill_manager()
    monkeypatch.setattr("poise.view.robot_recording._PATIENCE", 0.5)
    sentences: list[str] = []
    with pytest.raises(poise.NoManager, match=f"^{SENTENCE}") as caught:
        poise.record(tmp_path / "a.mcap", robot=NAME, say=sentences.append)
    assert caught.value.status is not None
    assert any("no answer" in each for each in sentences)


@pytest.mark.usefixtures("file")
def test_python_finds_it_too_and_its_errors_are_typed() -> None:
    before = kill_manager()
    running = poise.connect(NAME)
    seen = running.status()
    assert seen.by_agents
    assert dict(seen.placement) == before["placement"]
    with pytest.raises(poise.NoManager, match=SENTENCE) as caught:
        running.move("printer", "left")
    assert caught.value.status is not None
    assert caught.value.status.placement == seen.placement
    with pytest.raises(poise.NoManager):
        running.tasks.started()
    robots = robots_here()
    assert robots[NAME] is not None
    says(SENTENCE, str(next(iter(listing({NAME: robots[NAME]})))))
    look = LiveReader(NAME).poll()
    assert look.status is not None
    assert look.status.placement == seen.placement
    says(SENTENCE, look.trouble)
    assert 0 < look.since <= time.time()


def test_the_next_manager_takes_it_over_and_all_is_as_before(file: Path) -> None:
    before = kill_manager()
    up(file)
    after = status()
    assert not after["by_agents"]
    assert not after["deviations"]
    assert containers(after) == containers(before)
    assert not any(each["unmanaged"] for each in after["computers"].values())
    assert run_poise("status", "--robot", NAME).returncode == 0
    target = "left" if after["placement"]["printer"] == "right" else "right"
    done = run_poise("move", "printer", target, "--force", "--robot", NAME)
    assert done.returncode == 0, done.stderr


def test_the_next_manager_takes_it_over_though_its_agents_cannot_be_noted(
    file: Path,
) -> None:
    before = kill_manager()
    draft = folder() / f"{NAME}.new"
    draft.mkdir()  # no process may write a file there, not even one of root
    try:
        up(file)
    finally:
        draft.rmdir()
    assert containers(status()) == containers(before)
    log = file.with_name("poise") / f"{NAME}.log"
    assert "find the robot by --file only" in log.read_text()


def test_a_stop_ends_it_and_then_it_is_gone(file: Path) -> None:
    pids = containers(kill_manager())
    assert len(pids) == 2
    done = run_poise("stop", "--robot", NAME)
    assert done.returncode == 0, done.stderr
    wait_long(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids))
    gone = run_poise("status", "--robot", NAME)
    assert gone.returncode == 2
    assert f"robot '{NAME}' does not run here" in gone.stderr
    assert NAME not in robots_here()
    up(file)
    assert run_poise("status", "--robot", NAME).returncode == 0


def test_a_stop_by_its_file_ends_it_on_emulated_computers(file: Path) -> None:
    pids = containers(kill_manager())
    done = run_poise("stop", "--file", file)
    assert done.returncode == 0, done.stderr
    wait_long(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids))
    assert run_poise("status", "--file", file).returncode == 1


@pytest.mark.usefixtures("file")
def test_a_computer_that_does_not_answer_is_named_and_not_called_fine() -> None:
    kill_manager()
    assert run_poise("emulate", "crash", "right", "--robot", NAME).returncode == 0
    after = status()
    assert set(after["computers"]) == {"left"}
    assert set(after["out_of_reach"]) == {"right"}
    sentences = [each["what"] for each in after["deviations"]]
    says(SENTENCE, sentences[0])
    assert "the agent of 'right' (" in sentences[1]
    assert sentences[1].endswith("its components are not known")


@pytest.mark.usefixtures("file")
def test_it_is_gone_with_its_emulated_computers() -> None:
    kill_manager()
    assert run_poise("emulate", "stop", "--robot", NAME).returncode == 0
    assert run_poise("status", "--robot", NAME).returncode == 2
    assert NAME not in robots_here()


def test_a_stopped_manager_is_named_and_can_be_replaced(file: Path) -> None:
    before = status()
    pid = before["manager"]["pid"]
    with stopped(pid):
        said = rf"\(process {pid}\) has not answered for .*`kill -CONT {pid}`"
        # more than one move: what else waits then must not end the command
        moves = [("move", "printer", "left")] * 3
        for words in ("stop",), *moves, ("task", "list"):
            done = run_poise(*words, "--robot", NAME)
            assert done.returncode == 4, done.stderr
            says(said, done.stderr)
        after = status()
        assert after["by_agents"]
        assert containers(after) == containers(before)
        says(said, after["deviations"][0]["what"])
        wait_long(
            lambda: "agents have missed it since" in status()["deviations"][0]["what"]
        )
        up(file, "--take-over")
        assert status()["manager"]["pid"] != pid
    # it finds that it was replaced, and does not do what clients gave up
    wait_long(lambda: _has_ended(pid))
    after = status()
    assert containers(after) == containers(before)
    assert after["placement"] == before["placement"]
    assert after["manager"]["pid"] != pid
    kill_manager()  # the one that left did not forget where the agents are


@pytest.mark.usefixtures("file")
def test_a_stopped_manager_that_wakes_up_does_not_do_what_a_client_gave_up() -> None:
    before = status()
    with stopped(before["manager"]["pid"]):
        assert run_poise("stop", "--robot", NAME).returncode == 4
    # after a longer halt it hears its agents only a moment later
    wait_long(
        lambda: (
            not (now := status())["by_agents"]
            and len(containers(now)) == len(containers(before))
        )
    )
    after = status()
    assert after["manager"] == before["manager"]
    assert containers(after) == containers(before)


def _has_ended(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return True
    return stat.rpartition(")")[2].split()[0] == "Z"


def test_a_robot_on_real_computers_is_found_by_its_addresses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Agents that no keeper started: nothing but the manager's note leads to them."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "hello.py").write_text((HELLO / "hello.py").read_text())
    text = (HELLO / "robot.yaml").read_text().replace("robot: hello", f"robot: {NAME}")
    net = f"127.{os.getpid() % 200 + 40}.9"
    for number, name in enumerate(("left", "right"), 1):
        old = f"{name}: {{cpu: 0.5, "
        assert old in text
        text = text.replace(old, f"{old}address: {net}.{number}, ")
    file = tmp_path / "robot.yaml"
    file.write_text(text)
    with contextlib.ExitStack() as stack:
        for number, name in enumerate(("left", "right"), 1):
            words = ["agent", name, "--robot", NAME, "--address", f"{net}.{number}"]
            process = subprocess.Popen(
                [sys.executable, "-m", "poise", *words], stdout=subprocess.DEVNULL
            )
            stack.callback(process.wait, LONG)
            stack.callback(process.terminate)
        up(file)
        pids = containers(kill_manager())
        shown = run_poise("status", "--robot", NAME)
        assert shown.returncode == 4
        says(SENTENCE, shown.stdout)
        done = run_poise("stop", "--robot", NAME)
        assert done.returncode == 0, done.stderr
        wait_long(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids))
        assert run_poise("status", "--file", file).returncode == 1


@pytest.mark.parametrize(
    "asks", [poise.stop_without_manager, poise.status_without_manager]
)
def test_who_gives_the_file_of_a_robot_that_its_manager_emulates_learns_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asks: Callable[[poise.Robot], Any]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    robot = poise.load(HELLO / "robot.yaml")
    with pytest.raises(UsageError, match="components on emulated ones have ended"):
        asks(robot)
    path = path_of(robot.name)
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as manager:
        manager.bind(str(path))
        manager.listen()
        with pytest.raises(UsageError, match=r"'hello' runs here.* --robot hello "):
            asks(robot)


@pytest.mark.parametrize("answer", ["stopped", "something still runs", "elsewhere"])
def test_a_stop_by_the_file_goes_through_the_manager(
    monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    """It was refused while a manager lived."""
    agents = AgentAddresses("r", {"eye": "tcp/127.0.0.1:7447"})
    monkeypatch.setattr(without_manager, "_addresses", lambda _: agents)
    monkeypatch.setattr(without_manager, "stop_agents", lambda _: pytest.fail("ended"))
    remaining = () if answer == "stopped" else (answer,)
    ask = Mock(return_value=StopReport(remaining))
    if answer == "elsewhere":
        ask.side_effect = NoManager(answer, status=None)
    monkeypatch.setattr(without_manager, "ask", ask)
    hello = poise.model.load(HELLO / "robot.yaml")
    with (
        pytest.raises(RunError, match=answer) if remaining else contextlib.nullcontext()
    ):
        without_manager.stop_without_manager(hello)


def test_what_agents_end_no_standby_starts_again() -> None:
    """The standby of an agent that was out of reach has an older record."""
    eye = AgentStatus(computer="eye", generation=70000, uptime=1.0, cpu=0.0)
    agents = Mock(**{"statuses.return_value": {"eye": eye}, "manager.term": 2})
    without_manager._end_all(agents, {"eye"})
    last = agents.begin_deploy.call_args.args[1]
    before = Deployment(
        generation=90000, containers=(), desired=encode(Desired()), term=1
    )
    assert last.is_last
    assert newest_record([before, last]).is_stopped
