"""Real computers whose network is cut, and two managers that want the same agents."""

from __future__ import annotations

import json
import os
import re
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.emulate import Emulation, probe_host
from poise.errors import UsageError
from poise.manage.agent_connections.statuses import connectors_of
from poise.manage.control_socket.commands import MoveCommand, RobotStatus, StatusCommand
from poise.manage.control_socket.control_client import send_command
from poise.manage.migration.migration_report import MigrationReport
from poise.model.robot import Computer, Robot
from poise.session.keys import init_keys
from poise.wire.address import KEYS
from poise.wire.records.status_records import ConnectorStatus
from tests.command import POISE, run_poise
from tests.waiting import LONG, wait_long

pytestmark = pytest.mark.slow

NAMES = ("left", "right", "third")
MORE = {"right": ", resources: {lift: 1}"}
"""What only one of them has."""
CODE = """
import os
from poise import Component, Message, Published, every, subscribed

class Number(Message):
    value: int

def tell(what, number):
    path = os.path.join(os.path.dirname(__file__), what)
    with open(path + ".new", "w") as file:
        file.write(str(number))
    os.replace(path + ".new", path)

class Source(Component):
    numbers: Published[Number]
    count = 0

    @every(0.05)
    def tick(self):
        if os.path.exists(os.path.join(os.path.dirname(__file__), "halt")):
            return
        self.count += 1
        tell("sent", self.count)
        self.numbers.publish(Number(self.count))

    def snapshot(self):
        return self.count

    def restore(self, state: int):
        self.count = state

class Sink(Component):
    count = 0

    @subscribed(keep=10)
    def numbers(self, message: Number):
        self.count += 1
        tell("came", self.count)

class Alone(Component):
    pass
"""
FILE = """
robot: {name}
computers:
{computers}
architectures:
  work:
    function: work
    components:
      source: {{implementation: "reach:Source", only: [left, third], cpu: 1%,
               memory: 20 MiB}}
      sink: {{implementation: "reach:Sink", only: [right], cpu: 1%, memory: 20 MiB}}
      alone: {{implementation: "reach:Alone", only: [left, third], cpu: 1%,
              memory: 20 MiB, isolated: true}}
      large: {{implementation: "reach:Alone", cpu: 1%, memory: 20 MiB, isolated: true,
              resources: {{lift: 1}}}}
    connectors:
      - {{between: [source.numbers, sink.numbers]}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
"""


class Field:
    """Three computers with an agent each, as a robot's real ones."""

    def __init__(self, emulation: Emulation, folder: Path) -> None:
        self.name = f"reach{os.getpid()}"
        self.folder = folder
        self.computers = emulation.computers
        (folder / "reach.py").write_text(CODE)
        addresses = {n: c.address for n, c in self.computers.items()}
        authority = init_keys(self.name, folder / "owner")
        self.keys = str(authority.folder)
        for name in NAMES:
            keys = authority.issue(name, "agent", folder / "keys" / name)
            argv = [*POISE, "agent", name, "--robot", self.name]
            argv += ["--address", addresses[name], "--keys", str(keys.folder)]
            argv += ["--folder", str(self.computers[name].folder), "--allow", "/"]
            self.computers[name].popen(argv)
        self.file = folder / "robot.yaml"
        computers = "\n".join(
            f'  {n}: {{cpu: 0.5, memory: 512 MB, address: "{a}"{MORE.get(n, "")}}}'
            for n, a in addresses.items()
        )
        self.file.write_text(FILE.format(name=self.name, computers=computers))

    def forget(self) -> None:
        """Remove what components told, and were told, in an earlier test."""
        for name in ("sent", "came", "halt"):
            (self.folder / name).unlink(missing_ok=True)

    def set_cable(self, name: str, state: str) -> None:
        argv = ["ip", "link", "set", "eth0", state]
        assert self.computers[name].popen(argv).wait(LONG) == 0

    def status(self) -> RobotStatus:
        answer = send_command(self.name, StatusCommand())
        assert isinstance(answer, RobotStatus)
        return answer

    def pids(self) -> set[int]:
        status = self.status()
        return {c.pid for each in status.computers.values() for c in each.containers}


class Up:
    """`poise up`, and what it has printed."""

    def __init__(self, field: Field, runtime: Path, *options: str) -> None:
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [*POISE, "up", str(field.file), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(runtime)},
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            self.lines.extend(lines)

    def says(self, pattern: str) -> bool:
        return any(re.search(pattern, line) for line in list(self.lines))

    def wait_for(self, pattern: str) -> None:
        wait_long(lambda: self.says(pattern) or self.process.poll() is not None)
        assert self.says(pattern), "".join(self.lines)

    def end(self) -> int:
        self.process.terminate()
        code = self.process.wait(LONG)
        self._reader.join(LONG)
        return code


@pytest.fixture
def runtime(field: Field, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(KEYS, field.keys)
    folder = tmp_path / "one"
    folder.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return folder


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Field]:
    """Keep the agents up for all tests, as real computers do."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    computers = tuple(
        Computer(name=name, capacity={"cpu": 0.5, "memory": 512e6}) for name in NAMES
    )
    folder = tmp_path_factory.mktemp("field")
    with Emulation(Robot(name="reach", computers=computers), folder) as emulation:
        yield Field(emulation, folder)


@pytest.fixture
def up(field: Field, runtime: Path, request: pytest.FixtureRequest) -> Iterator[Up]:
    field.forget()
    up = Up(field, runtime, *getattr(request, "param", ()))
    try:
        up.wait_for("is up with task")
        yield up
    finally:
        for name in NAMES:
            field.set_cable(name, "up")
        up.end()


def is_well() -> bool:
    """Return whether all is as the robot file says; a busy machine may be late."""
    return run_poise("status").returncode == 0


def test_goes_on_without_a_computer_and_brings_it_back(field: Field, up: Up) -> None:
    wait_long(is_well)
    before = field.pids()

    field.set_cable("right", "down")
    up.wait_for(
        r"'right' has been out of reach since .*sink (may still be at work|stops)"
    )
    status = run_poise("status")
    assert status.returncode == 1
    assert "computer 'right' has been out of reach since" in status.stdout
    told = json.loads(run_poise("status", "--json").stdout)
    assert list(told["out_of_reach"]) == ["right"]
    assert "right" in [each["computer"] for each in told["deviations"]]

    # what has nothing to do with it is managed on
    moved = run_poise("move", "alone", "third" if at(field) == "left" else "left")
    assert moved.returncode == 0, moved.stdout + moved.stderr

    field.set_cable("right", "up")
    up.wait_for("computer 'right' is reached again")
    wait_long(is_well)
    assert up.process.poll() is None
    moved_container = 1
    assert len(before & field.pids()) == len(before) - moved_container


def test_components_of_a_lost_computer_go_on_elsewhere(field: Field, up: Up) -> None:
    lost = at(field, "source")
    there = "third" if lost == "left" else "left"
    field.set_cable(lost, "down")
    up.wait_for(rf"components of a lost computer restart: .*'source' on '{there}'")
    up.wait_for("the components run again")
    assert at(field, "source") == there
    assert f"'{lost}' has been out of reach since" in run_poise("status").stdout
    said = f"component 'source' started without the state that it had on '{lost}'"
    assert said in run_poise("status").stdout

    field.set_cable(lost, "up")
    up.wait_for(f"computer '{lost}' is reached again")
    wait_long(is_well)
    assert at(field, "source") == there
    active = [
        computer
        for computer, status in field.status().computers.items()
        for container in status.containers
        for component in container.components
        if component.name == "source" and component.state == "active"
    ]
    assert active == [there]


# what moves counts anew
@pytest.mark.parametrize("up", [("--no-adapt",)], indirect=True)
@pytest.mark.parametrize("ends_amid", [True, False])
def test_what_a_cut_loses_is_counted(field: Field, up: Up, *, ends_amid: bool) -> None:
    """Where it could not go out, did not come, or found no room; also at the end."""
    halt = field.folder / "halt"
    wait_long((field.folder / "came").exists)
    field.set_cable("right", "down")
    up.wait_for("computer 'right' has been out of reach since")
    wait_long(lambda: ends(field)["source"].drops > 0)
    if ends_amid:  # nothing that comes later tells what was lost
        halt.touch()
    field.set_cable("right", "up")
    up.wait_for("computer 'right' is reached again")
    if not ends_amid:
        before = ends(field)["target"].messages
        wait_long(lambda: ends(field)["target"].messages > before + 50)
        halt.touch()

    def is_all_counted() -> bool:
        sent, came = (int((field.folder / n).read_text()) for n in ("sent", "came"))
        source, target = (ends(field)[end] for end in ("source", "target"))
        is_whole = source.messages + source.drops == sent
        return is_whole and sent == came + source.drops + target.drops

    wait_long(is_all_counted)
    assert all(end.drops > 0 for end in ends(field).values())


def ends(field: Field) -> dict[str, ConnectorStatus]:
    """Return what the two ends of the connector counted."""
    return {each.end: each for each in connectors_of(field.status().computers)}


def test_what_must_stay_on_a_lost_computer_is_missing(field: Field, up: Up) -> None:
    field.set_cable("right", "down")
    up.wait_for("component 'sink' of 'right' is missing: it may run on right only")
    up.wait_for("component 'large' of 'right' is missing: it fits nowhere")
    field.set_cable("right", "up")
    wait_long(is_well)


CUT = 0.5
"""Shorter than an agent's lease [s], and long enough for what is sent to be lost."""


def test_the_first_move_after_a_short_cut_works(field: Field, up: Up) -> None:
    for name in ("left", "third", "right"):
        there = "third" if at(field, "source") == "left" else "left"
        field.set_cable(name, "down")
        threading.Event().wait(CUT)
        field.set_cable(name, "up")
        if move_when_reached(field, there):
            moved = rf"moved component 'source' from .* to '{there}'"
            up.wait_for(rf"\d\d:\d\d:\d\d {moved}")
        assert at(field, "source") == there
    wait_long(is_well)


def move_when_reached(field: Field, there: str) -> bool:
    """Move at once; later where a cut took long enough on a busy machine to be seen.

    Return whether it was moved: a cut that was seen for longer has brought it there.
    """
    reasons: list[str] = []

    def is_answered() -> bool:
        reasons.append(refusal_of_move(field, there))
        return not re.search("is cut|out of reach|changed meanwhile", reasons[-1])

    wait_long(is_answered)
    was_moved = not reasons[-1]
    assert was_moved or reasons[-1].endswith(f"on '{there}' already"), reasons
    return was_moved


def refusal_of_move(field: Field, there: str) -> str:
    try:
        moved = send_command(field.name, MoveCommand("source", there))
    except UsageError as error:
        return str(error)
    assert isinstance(moved, MigrationReport)
    return moved.reason


def test_a_component_moves_where_it_does_not_fit_only_by_force(
    field: Field, up: Up
) -> None:
    there = "third" if at(field) == "left" else "left"
    rehearsed = run_poise("move", "large", there, "--dry-run")
    assert rehearsed.returncode == 2
    assert "it would be refused" in rehearsed.stdout
    allowed = run_poise("move", "large", there, "--dry-run", "--force")
    assert allowed.returncode == 0, allowed.stderr
    refused = run_poise("move", "large", there)
    assert refused.returncode == 2
    words = (
        rf"'large' does not fit on '{there}' \({there}: lift needs 1, has 0: 1 short"
    )
    assert re.search(words, refused.stderr)
    assert "--force" in refused.stderr
    assert field.status().placement["large"] == "right"
    forced = run_poise("move", "large", there, "--force")
    assert forced.returncode == 0, forced.stdout + forced.stderr
    assert field.status().placement["large"] == there
    up.wait_for(f"moved component 'large' from 'right' to '{there}'")


def at(field: Field, component: str = "alone") -> str:
    return field.status().placement[component]


def test_a_stop_names_what_it_does_not_reach(field: Field, up: Up) -> None:
    field.set_cable("right", "down")
    up.wait_for("computer 'right' has been out of reach since")
    stopped = run_poise("stop")
    assert stopped.returncode == 1
    assert re.search(
        r"'right' has been out of reach since .*sink may still be at work",
        stopped.stderr,
    )
    assert up.process.wait(LONG) == 1

    stopped = run_poise("stop", "--file", field.file)
    assert stopped.returncode == 1
    assert "out of reach: right" in stopped.stderr
    field.set_cable("right", "up")
    wait_long(lambda: run_poise("stop", "--file", field.file).returncode == 0)


def test_a_second_manager_is_refused_until_the_first_is_gone(
    field: Field, up: Up, tmp_path: Path
) -> None:
    before = field.pids()
    other = tmp_path / "two"
    other.mkdir()
    second = Up(field, other)
    assert second.process.wait(LONG) == 3
    pid = up.process.pid
    assert second.says(rf"'{field.name}' is managed by user .*\(process {pid}\) since")
    assert field.pids() == before
    wait_long(is_well)

    up.process.kill()
    up.process.wait(LONG)
    third = Up(field, other)
    third.wait_for("is running: taking it over")
    third.wait_for("is up with task")
    stop = run_poise("stop", "--file", field.file)
    assert (stop.returncode, stop.stdout) == (0, "stopped\n")
    assert third.process.wait(LONG) == 0
