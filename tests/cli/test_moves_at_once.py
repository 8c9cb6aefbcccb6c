"""Several people ask one running robot for changes at the same moment.

Each gets it done or is clearly refused; nothing that the components say to each other
is lost, doubled or left hanging; and what `poise status` tells is so.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from poise.errors import PoiseError
from poise.manage.control_socket.commands import MoveCommand, RobotStatus, StatusCommand
from poise.manage.control_socket.control_client import send_command
from poise.manage.migration.migration_report import MigrationReport
from tests.command import POISE, robot_up
from tests.manage.agents import TELLING
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow]

NAME = f"crowded{os.getpid()}"
CODE = (
    TELLING
    + '''
class Done(Message):
    sent: int
    answered: int
    refused: int
    served: int

class Partner(Telling):
    """Asks another who asks it; numbers what it publishes."""

    numbers: Published[Number]
    asks: Required[Doubles]
    doubles: Provided[Doubles]
    reentrant = True

    def configure(self):
        super().configure()
        self.sent = self.answered = self.refused = self.served = 0

    def double(self, value: int) -> int:
        self.served += 1
        return 2 * value

    @every(0.01)
    def work(self):
        is_halted = os.path.exists(os.path.join(self.parameters["folder"], "halt"))
        if not is_halted:
            self.sent += 1
            self.numbers.publish(Number(self.sent))
            try:
                self.answered += self.asks.double(self.sent) == 2 * self.sent
            except CallError:  # it was kept from running while the other moved
                self.refused += 1
        self.tell(self.sent, self.answered, self.refused, self.served, is_halted)

    def snapshot(self) -> Done:
        return Done(self.sent, self.answered, self.refused, self.served)

    def restore(self, state: Done) -> None:
        self.sent, self.answered = state.sent, state.answered
        self.refused, self.served = state.refused, state.served

class Otherwise(Partner):
    """Another implementation."""

class Come(Message):
    came: dict[str, int]
    wrong: int

class Sink(Telling):
    """Counts what comes, and what does not follow what came before."""

    def configure(self):
        super().configure()
        self.came, self.wrong = {"ping": 0, "pong": 0}, 0

    @subscribed(block=100)
    def pings(self, message: Number):
        self.count("ping", message)

    @subscribed(block=100)
    def pongs(self, message: Number):
        self.count("pong", message)

    def count(self, who, message):
        self.came[who] += 1
        self.wrong += message.value != self.came[who]
        self.tell(self.came["ping"], self.came["pong"], self.wrong)

    def snapshot(self) -> Come:
        return Come(self.came, self.wrong)

    def restore(self, state: Come) -> None:
        self.came, self.wrong = dict(state.came), state.wrong

class Slow(Component):
    """Keeps the manager busy while a file is there, and tells so by another."""

    def configure(self):
        busy = os.path.join(self.parameters["folder"], "busy")
        while os.path.exists(busy):
            open(busy + "-now", "w").close()
            threading.Event().wait(0.01)
'''
)
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
  third: {{cpu: 1, memory: 1 GiB}}
architectures:
  talking:
    function: talk
    home: left
    components:
      ping: &any {{implementation: "crowded:Partner", cpu: 5%, memory: 50 MiB,
                  parameters: {{folder: "{folder}"}}}}
      pong: *any
      sink: {{implementation: "crowded:Sink", cpu: 5%, memory: 50 MiB,
             parameters: {{folder: "{folder}"}}}}
      slow: {{implementation: "crowded:Slow", isolated: true, cpu: 5%, memory: 50 MiB,
             parameters: {{folder: "{folder}"}}}}
    connectors:
      - {{between: [ping.asks, pong.doubles], limit: 20 s}}
      - {{between: [pong.asks, ping.doubles], limit: 20 s}}
      - {{between: [ping.numbers, sink.pings], limit: 20 s}}
      - {{between: [pong.numbers, sink.pongs], limit: 20 s}}
tasks:
  talk: {{actions: [{{name: talk, functions: [talk]}}]}}
"""


class Crowd:
    """A robot that runs, and the commands that people give it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._slow_is = "left"

    def at_once(self, *commands: str) -> list[str]:
        """Give commands while the manager is busy; return what each said.

        They come to it in this order. A command that failed says its exit code first.
        """
        with contextlib.ExitStack() as stack:
            with self.busy():
                running = [self.waiting(each, stack) for each in commands]
            said = []
            for command in running:
                told, _ = command.communicate(timeout=LONG)
                assert "Traceback" not in told, told
                code = command.returncode
                said.append(f"{code}: {told}" if code else told)
        return said

    @contextlib.contextmanager
    def busy(self) -> Iterator[None]:
        """Let the manager be in the middle of a move."""
        busy, is_busy = self.folder / "busy", self.folder / "busy-now"
        is_busy.unlink(missing_ok=True)
        busy.touch()
        self._slow_is = "right" if self._slow_is == "left" else "left"
        with ThreadPoolExecutor(1) as pool:
            move = pool.submit(send_command, NAME, MoveCommand("slow", self._slow_is))
            try:
                wait_long(is_busy.exists)
                yield
            finally:
                busy.unlink()
            report = move.result(LONG)
        assert isinstance(report, MigrationReport)
        assert report.committed, report.reason

    def waiting(
        self, command: str, stack: contextlib.ExitStack
    ) -> subprocess.Popen[str]:
        """Start a command and wait until it waits for the manager, or is done."""
        started = stack.enter_context(_started(command))
        wait_long(lambda: _has_socket(started.pid) or started.poll() is not None)
        return started

    def told(self, component: str) -> list[int]:
        """Return the numbers that a component told last; zeros before it did."""
        file = self.folder / component
        said = file.read_bytes() if file.exists() else b""
        return [int(said[k : k + 10]) for k in range(0, len(said), 10)] or [0] * 5

    def check_all_came(self) -> None:
        """Hold that all that was said came once and in order, and all was answered.

        A call may have been refused when its caller was kept from running for too long.
        """
        (self.folder / "halt").touch()
        with contextlib.suppress(AssertionError):  # what follows tells more
            wait_long(self._is_steady)
        ping, pong = self.told("ping"), self.told("pong")
        assert self.told("sink") == [ping[0], pong[0], 0]
        for (sent, answered, refused, *_), other in ((ping, pong), (pong, ping)):
            served = other[3]
            assert answered + refused == sent
            assert 0 < answered <= served <= sent
        (self.folder / "halt").unlink()

    def check_status(self, **placement: str) -> None:
        """Hold that these run there, and each where the status says, alone."""

        def tells_it() -> bool:
            told = status()
            is_so = told.placement.items() == _runs(told)
            return is_so and placement.items() <= told.placement.items()

        wait_long(tells_it)

    def _is_steady(self) -> bool:
        ping, pong = self.told("ping"), self.told("pong")
        is_halted = bool(ping[4] and pong[4])
        is_answered = all(each[1] + each[2] == each[0] for each in (ping, pong))
        is_told = ping[3] >= pong[1] and pong[3] >= ping[1]
        came = self.told("sink")[:2] == [ping[0], pong[0]]
        return is_halted and is_answered and is_told and came


def _runs(told: RobotStatus) -> set[tuple[str, str]]:
    return {
        (component.name, computer)
        for computer, each in told.computers.items()
        for container in each.containers
        for component in container.components
    }


@contextlib.contextmanager
def _started(command: str) -> Iterator[subprocess.Popen[str]]:
    argv = [*POISE, *command.split(), "--robot", NAME]
    with subprocess.Popen(
        argv, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        yield process


def _has_socket(pid: int) -> bool:
    links = []
    for file in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            links.append(os.fspath(file.readlink()))
    return any(link.startswith("socket:") for link in links)


def status() -> RobotStatus:
    answer = send_command(NAME, StatusCommand())
    assert isinstance(answer, RobotStatus)
    return answer


def is_up() -> bool:
    try:
        status()
    except PoiseError:
        return False
    return True


@pytest.fixture
def crowd(tmp_path: Path) -> Iterator[Crowd]:
    (tmp_path / "crowded.py").write_text(CODE)
    robot = tmp_path / "robot.yaml"
    robot.write_text(ROBOT.format(name=NAME, folder=tmp_path))
    with robot_up(robot, "--placement", "static"):
        crowd = Crowd(tmp_path)
        wait_long(lambda: min(crowd.told("ping")[1], *crowd.told("sink")[:2]) > 0)
        yield crowd


def test_moves_at_once_are_made_one_after_the_other(crowd: Crowd) -> None:
    # of the same component, to the same computer
    first, second = crowd.at_once("move ping right", "move ping right")
    assert "ping runs on right now" in first
    assert "2: component 'ping' runs on 'right' already" in second
    crowd.check_status(ping="right", pong="left")

    # of the same component, to different computers
    first, second = crowd.at_once("move ping third", "move ping left")
    assert "ping runs on third now" in first
    assert "ping runs on left now" in second
    crowd.check_status(ping="left", pong="left")

    # of two that call each other: away from each other, and past each other
    for ping, pong in (("right", "third"), ("third", "right")):
        first, second = crowd.at_once(f"move ping {ping}", f"move pong {pong}")
        assert f"ping runs on {ping} now" in first
        assert f"pong runs on {pong} now" in second
        crowd.check_status(ping=ping, pong=pong)
    crowd.check_all_came()


def test_other_changes_wait_for_a_move_as_it_waits_for_them(crowd: Crowd) -> None:
    before, replaced, balanced, after = crowd.at_once(
        "move ping right",
        "replace ping crowded:Otherwise",
        "balance",
        "move pong third",
    )
    assert "ping runs on right now" in before
    assert "ping runs on right now" in replaced
    assert "F = " in balanced or "best as it is" in balanced
    assert "pong runs on third now" in after or "on 'third' already" in after
    crowd.check_status(pong="third")  # the others are where the balance put them
    crowd.check_all_came()


def test_status_and_stop_overtake_a_move(crowd: Crowd) -> None:
    busy, is_busy = crowd.folder / "busy", crowd.folder / "busy-now"
    busy.touch()
    with _started("move slow right") as moving, contextlib.ExitStack() as stack:
        wait_long(is_busy.exists)
        queued = crowd.waiting("move pong right", stack)
        assert status().placement["slow"] == "left"
        stopping = crowd.waiting("stop", stack)
        told = stopping.communicate(timeout=LONG)[0]
        assert "stopped, but: container '" in told  # after what it waited for
        assert "container 'talking.slow' on 'right' was ended: " in told
        assert "'configure' has run for" in told
        assert busy.exists()  # the move could not have ended by itself
        told = moving.communicate(timeout=LONG)[0]
        stays = "slow stays on left: the robot is being stopped\n"
        assert told.endswith((stays, f"robot '{NAME}' has stopped\n"))
        assert moving.returncode == 1
        told = queued.communicate(timeout=LONG)[0]  # it waited for no other
        ends = ("the robot is being stopped\n", f"robot '{NAME}' has stopped\n")
        assert "pong runs on right now" in told or told.endswith(ends)
    wait_long(lambda: not is_up())
