"""What the journal and `poise status` say of containers that were killed."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from poise.emulate import probe_host
from poise.manage.control_socket.commands import RobotStatus, StatusCommand
from poise.manage.control_socket.control_client import send_command
from poise.manage.journal import JournalEntry, read_journal
from tests.command import robot_up, run_poise
from tests.waiting import wait_long

pytestmark = pytest.mark.slow

NAME = f"faults{os.getpid()}"

CODE = """
import os
from poise import Component, Message, every

class Worker(Component):
    @every(0.05)
    def work(self):
        grow = os.path.join(self.parameters["folder"], "grow")
        if os.path.exists(grow):
            os.unlink(grow)
            self.much = b"x" * (1 << 30)

class State(Message):
    pass

class Keeper(Worker):
    def snapshot(self):
        return State()

    def restore(self, state: State):
        pass
"""

ROBOT = """
robot: {name}
computers:
  small: {{cpu: 0.5, memory: 400 MiB}}
architectures:
  working:
    function: work
    components:
      worker:
        implementation: "faults:Keeper"
        cpu: 5%
        memory: 50 MiB
        parameters: {{folder: "{folder}"}}
      other: {{implementation: "faults:Worker", cpu: 5%, memory: 50 MiB,
              parameters: {{folder: "/nonexistent"}}}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
"""


@pytest.fixture
def up(tmp_path: Path) -> Iterator[Path]:
    """Start the robot."""
    (tmp_path / "faults.py").write_text(CODE)
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.format(name=NAME, folder=tmp_path))
    with robot_up(file, "--journal", tmp_path / "journal"):
        yield tmp_path


def status() -> RobotStatus:
    answer = send_command(NAME, StatusCommand())
    assert isinstance(answer, RobotStatus)
    return answer


def pid() -> int:
    (computer,) = status().computers.values()
    return computer.containers[0].pid if computer.containers else 0


def journal(up: Path) -> list[JournalEntry]:
    """Return what went wrong and right."""
    entries = read_journal(up / "journal")
    return [each for each in entries if each.kind in {"wrong", "right"}]


def break_by(up: Path, harm: Callable[[int], object]) -> list[JournalEntry]:
    """Let a container break; return what was journalled when it runs again."""
    before, known = pid(), len(journal(up))
    harm(before)
    wait_long(lambda: [e for e in journal(up)[known:] if e.kind == "right"])
    assert pid() not in {0, before}
    return journal(up)[known:]


def test_a_kill_is_one_line_and_its_end_another(up: Path) -> None:
    wrong, right = break_by(up, lambda pid: os.kill(pid, signal.SIGKILL))
    assert wrong.what == (
        "container 'working' on 'small' was killed by SIGKILL; the state of "
        "'worker' is gone: it restarts"
    )
    assert right.what == "container 'working' on 'small' is healthy again"
    done = run_poise("status", "--robot", NAME)
    assert done.returncode == 0, done.stdout
    assert (
        "everything is as the robot file says; 1 fault since the start (below)"
        in done.stdout
    )
    for _ in range(2):
        break_by(up, lambda pid: os.kill(pid, signal.SIGKILL))
    done = run_poise("status", "--robot", NAME)
    assert done.returncode == 1
    assert "is in a crash loop" in done.stdout


def test_an_end_for_lack_of_memory_is_named(up: Path) -> None:
    if "memory" not in probe_host().groups.controls:
        pytest.skip("no cgroup to write to with memory: nothing limits the computer")
    # while it takes the memory it may also not respond for a while, which is told too
    entries = break_by(up, lambda _: (up / "grow").touch())
    ran_out = "was killed because its computer ran out of memory (OOM)"
    told = f"container 'working' on 'small' {ran_out} (limit 400 MiB)"
    assert sum(told in entry.what for entry in entries) == 1, entries
    (health,) = status().computers["small"].health
    assert health.last_fault is not None
    assert health.last_fault.message.startswith(ran_out)
    shown = " ".join(run_poise("status", "--robot", NAME).stdout.split())
    assert ran_out in shown


@pytest.mark.usefixtures("up")
def test_a_stopped_container_is_shown_with_the_command_that_continues_it() -> None:
    stopped = pid()
    os.kill(stopped, signal.SIGSTOP)
    try:
        wait_long(lambda: status().deviations)
        done = run_poise("status", "--robot", NAME)
    finally:
        os.kill(stopped, signal.SIGCONT)
    assert done.returncode == 1
    assert f"`kill -CONT {stopped}` lets it go on (noticed " in done.stdout
    wait_long(lambda: not status().deviations)


@pytest.mark.parametrize("who", ["container 'working'", "the gateway"])
def test_a_lack_of_file_descriptors_is_told_until_it_is_over(
    up: Path, who: str
) -> None:
    short = container = pid()
    if who == "the gateway":  # it is in the agent, the parent of the zygote
        short = parent(parent(container))
    limits = resource.prlimit(short, resource.RLIMIT_NOFILE)
    resource.prlimit(short, resource.RLIMIT_NOFILE, (8, limits[1]))
    try:
        wait_long(lambda: status().deviations)
        done = run_poise("status", "--robot", NAME)
    finally:
        resource.prlimit(short, resource.RLIMIT_NOFILE, limits)
    assert done.returncode == 1
    told = f"on 'small' {who} accepts no connection for now: [Errno 24] Too many open"
    shown = " ".join(done.stdout.split())
    assert told in shown
    assert f"Process {short} may open 8 files: raise that where" in shown
    wait_long(lambda: not status().deviations)
    assert pid() == container
    assert journal(up)[0].what.startswith(told)

    def has_ended() -> bool:
        said = {entry.what for entry in journal(up)}
        # beside it the agent may say that it cannot keep its state, until that is over
        ended = {what for what in said if what.startswith("no more: ")}
        return ended == {f"no more: {what}" for what in said - ended}

    wait_long(has_ended)  # the journal hears of it at the manager's next look
    assert run_poise("status", "--robot", NAME).returncode == 0


def parent(child: int) -> int:
    """Return the parent of a process."""
    return int(Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[1])
