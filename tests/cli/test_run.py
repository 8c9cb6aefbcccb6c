"""`poise run` as a person runs it: real processes on emulated computers."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from poise.cli.run_command import run_command
from poise.emulate import sweep
from poise.emulate.registry import registry
from poise.errors import PoiseError
from poise.manage.journal import read_journal
from poise.session.folders import find_journal
from poise.waker import wait_readable
from poise.wire.robots_here import path_of
from tests.command import POISE, called, run_poise
from tests.waiting import wait_until

LIMIT = 60.0
_started: list[int] = []
HELLO = Path(__file__).parents[2] / "examples" / "hello" / "robot.yaml"

CODE = """
import os, signal
from pathlib import Path
from poise import Component, every

class Quiet(Component): pass

class Announcing(Component):
    def activate(self):
        print("up", os.getpid(), os.getppid(), flush=True)

class Angry(Component):
    def configure(self):
        raise LookupError("no map here")

class Grumbling(Component):
    @every(0.01)
    def tick(self):
        raise LookupError("again")

class Murderous(Component):
    def activate(self):
        zygote = os.getppid()
        agent = int(open(f"/proc/{zygote}/stat").read().split()[3])
        os.kill(agent, signal.SIGKILL)

class MurderousLater(Component):
    has_done = False

    @every(0.1)
    def act(self):
        if not self.has_done and Path(__file__).with_name("now").exists():
            self.has_done = True
            Murderous.activate(self)
"""

ROBOT = """
robot: tiny
computers:
  left: {{cpu: 1, memory: 1 GiB, speed: 0.4}}
  right: {{cpu: 1, memory: 1 GiB, speed: 0.4}}
architectures:
  working:
    function: work
    home: left
    components:
      worker: {{{component}, cpu: 5%, memory: 20 MiB}}
{more}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
"""
COMMAND = """
      teller: {command: [sh, -c, 'echo I am $POISE_COMPONENT; exec sleep 100'], cpu: 5%}
"""


def start(*arguments: object) -> subprocess.Popen[str]:
    """Start `poise run` with everything it prints in one pipe."""
    process = subprocess.Popen(
        [*POISE, "run", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    _started.append(process.pid)
    return process


def run(*arguments: object) -> tuple[int, str]:
    process = start(*arguments)
    said, _ = process.communicate(timeout=LIMIT)
    return process.returncode, said


Write = Callable[..., Path]


@pytest.fixture
def robot(tmp_path: Path) -> Write:
    """Write a robot file for one component and the module it may name."""

    def write(component: str, more: str = "") -> Path:
        (tmp_path / "tiny_robot.py").write_text(textwrap.dedent(CODE))
        path = tmp_path / "robot.yaml"
        path.write_text(ROBOT.format(component=component, more=more))
        return path

    return write


def implementation(name: str) -> str:
    return f'implementation: "tiny_robot:{name}"'


def remains() -> set[str]:
    """Return what the runs of this test left on this machine."""
    ours = tuple(f"poise-{pid}-" for pid in _started)
    return {
        f"{folder}/{name}"
        for place in (registry(), "/run/netns", "/sys/fs/cgroup")
        # unlike `Path.glob`, it goes on when a folder of another test vanishes
        for folder, folders, files in os.walk(place)
        for name in (*folders, *files)
        if name.startswith(ours)
    }


def is_swept() -> bool:
    """Remove what dead runs left; whether all is gone: another run may be at it."""
    sweep()
    return not remains()


@pytest.fixture
def leaves_nothing() -> Iterator[None]:
    """Hold that nothing of a run is there after its test."""
    _started.clear()
    yield
    assert remains() == set()


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("leaves_nothing")]


def test_a_run_ends_with_a_report_and_prints_nothing_else(tmp_path: Path) -> None:
    report = tmp_path / "report"
    arguments = ["--task", "greet", "--for", "2s", "--report", str(report), "--json"]
    result = run_poise("run", HELLO, *arguments)
    told = json.loads(result.stdout)
    # a machine too busy for the emulation makes the run invalid: exit code 1
    assert result.returncode == (1 if told["invalid"] else 0), result.stderr
    assert told == json.loads((report / "report.json").read_text())
    assert told["placement"].keys() == {"counter", "printer"}
    assert {c["name"] for c in told["components"]} == {"counter", "printer"}
    assert told["faults"] == []
    assert (report / "journal.jsonl").exists()
    assert "all components run" in [entry["what"] for entry in told["journal"]]
    assert "all components run" in (report / "report.html").read_text()
    if not told["invalid"]:
        assert "printer has 10" in result.stderr


def test_a_report_that_cannot_be_written_is_printed_all_the_same(
    robot: Write, tmp_path: Path
) -> None:
    (tmp_path / "report" / "report.html").mkdir(parents=True)
    options = ["--task", "work", "--for", "1s", "--report", str(tmp_path / "report")]
    code, said = run(robot(implementation("Quiet")), *options)
    assert code == 1
    assert "report.html cannot be written: Is a directory" in said.replace("\n", "")
    assert "ran for 1" in said


def test_a_component_that_raises_on_start_ends_the_run(robot: Write) -> None:
    code, said = run(robot(implementation("Angry")), "--task", "work")
    kept = [each.what for each in read_journal(find_journal("tiny"))]
    assert "task 'work', auto placement" in kept
    assert code == 1
    assert "component 'worker' on " in said
    assert "LookupError: no map here" in said


@pytest.mark.parametrize(
    ("component", "says"),
    [
        ('implementation: "no_such_module:Any"', "no module 'no_such_module'"),
        (implementation("Qiet"), "did you mean 'Quiet'?"),
        (implementation("Quiet") + ", devices: [eye]", "no device 'eye'"),
    ],
)
def test_a_file_with_problems_starts_nothing(
    robot: Write, component: str, says: str
) -> None:
    done = called(["run", str(robot(component)), "--task", "work"])
    assert done.returncode == 1
    assert says in done.stderr
    assert "emulating" not in done.stdout + done.stderr


def test_what_is_described_for_planning_only_does_not_run(robot: Write) -> None:
    done = called(["run", str(robot("movable: true")), "--task", "work"])
    assert done.returncode == 1
    assert "components without `implementation` or `command`: worker" in done.stderr
    assert "emulating" not in done.stdout + done.stderr


def test_errors_of_a_component_that_goes_on_are_told_and_can_be_allowed(
    robot: Write,
) -> None:
    options = ["--task", "work", "--for", "1s", "--allow-errors"]
    code, said = run(robot(implementation("Grumbling")), *options)
    assert "worker:" in said
    assert "LookupError: again" in said
    assert code == 0 or "invalid run" in said


def test_a_start_goes_on_when_an_agent_is_killed(robot: Write) -> None:
    options = ["--task", "work", "--for", "1s"]
    code, said = run(robot(implementation("Murderous")), *options)
    assert code == 0 or "invalid run" in said, said
    assert re.search(r"computer .\w+. has been out of reach since", said)
    assert re.search(r"computer .\w+. is reached again", said)


def test_a_run_goes_on_when_an_agent_is_killed(robot: Write) -> None:
    """And with a component that is a command.

    The agent is not back yet at the end of the time: its counts are waited for.
    """
    file = robot(implementation("MurderousLater"), COMMAND)
    process = start(file, "--task", "work", "--for", "2s")
    assert process.stdout is not None
    before = ""
    while not ("running task" in before and "I am teller" in before):
        before += (line := process.stdout.readline())
        assert line, before
    file.with_name("now").touch()
    after, _ = process.communicate(timeout=LIMIT)
    said = before + after
    assert process.returncode == 0 or "invalid run" in said, said
    assert re.search(r"the agent of .\w+. was restarted; 1 container went on", said)


@pytest.mark.parametrize(
    ("task", "for_", "says"),
    [
        ("greet", "soon", "--for soon"),
        ("greet", "0 s", "longer than 0 s"),
        ("grete", "1 s", "no task 'grete'"),
    ],
)
def test_used_wrongly_it_says_so_and_starts_nothing(
    task: str, for_: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(PoiseError, match=says):
        run_command(HELLO, task, for_=for_)
    assert "emulating" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [["--task", "greet", "--placement", "lucky"], ["--tsak", "greet"]]
)
def test_options_that_are_wrong_end_with_code_2(arguments: list[str]) -> None:
    assert called(["run", str(HELLO), *arguments]).returncode == 2


@pytest.mark.parametrize("command", ["run", "up"])
def test_without_a_task_it_says_how_to_write_one(command: str, tmp_path: Path) -> None:
    text = HELLO.read_text()
    (tmp_path / "robot.yaml").write_text(text[: text.index("tasks:")])
    (tmp_path / "hello.py").write_text((HELLO.parent / "hello.py").read_text())
    done = called([command, str(tmp_path / "robot.yaml")])
    assert done.returncode == 1
    assert "robot 'hello' has no task to run: add" in done.stderr


@pytest.mark.parametrize(
    ("sent", "code", "moment"),
    [
        (signal.SIGINT, 130, "emulating"),
        (signal.SIGTERM, 143, "starting"),
        (signal.SIGINT, 130, "up"),
    ],
)
def test_a_signal_ends_everything(
    robot: Write, sent: signal.Signals, code: int, moment: str
) -> None:
    process = start(
        robot(implementation("Announcing")), "--task", "work", "--for", "60s"
    )
    assert process.stdout is not None
    pids: list[int] = []
    for line in process.stdout:
        if line.startswith("up"):
            pids = [int(pid) for pid in line.split()[1:]]
        if line.startswith(moment):
            break
    process.send_signal(sent)
    rest, _ = process.communicate(timeout=LIMIT)
    assert process.returncode == code, rest
    for pid in pids:
        assert not Path(f"/proc/{pid}").exists()


def status_of_tiny() -> dict[str, Any]:
    status = run_poise("status", "--robot", "tiny", "--json").stdout
    answer: dict[str, Any] = json.loads(status)
    return answer


def test_others_see_a_run_move_its_components_and_stop_it(robot: Write) -> None:
    file = robot(implementation("Announcing"))
    process = start(file, "--task", "work", "--for", "600s")
    assert process.stdout is not None
    assert any("`poise top`" in line for line in process.stdout)
    assert status_of_tiny()["placement"] == {"worker": "left"}
    wait_until(lambda: status_of_tiny()["deviations"] == [])
    moved = run_poise("move", "worker", "right", "--robot", "tiny")
    assert moved.returncode == 0, moved.stderr
    assert status_of_tiny()["placement"] == {"worker": "right"}
    assert run_poise("stop", "--robot", "tiny").returncode == 0
    rest, _ = process.communicate(timeout=LIMIT)
    assert process.returncode == 1  # it measured nothing
    assert "invalid run: `poise stop` ended it" in " ".join(rest.split())


def test_nothing_survives_a_manager_that_is_killed(robot: Write) -> None:
    process = start(
        robot(implementation("Announcing")), "--task", "work", "--for", "60s"
    )
    assert process.stdout is not None
    line = next(line for line in process.stdout if line.startswith("up"))
    pidfds = [os.pidfd_open(int(pid)) for pid in line.split()[1:]]
    assert remains()  # or the test looks in the wrong place
    process.kill()
    for pidfd in pidfds:
        assert wait_readable([pidfd], LIMIT)
        os.close(pidfd)
    process.communicate(timeout=LIMIT)
    wait_until(is_swept, every=0.1)  # as the next run does
    path_of("tiny").unlink()  # the same
