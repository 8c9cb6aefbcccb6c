"""Clients of a simulated robot: what they ask of its manager, and what must follow."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Literal, TypeVar

from poise.manage.control_socket.commands import (
    Command,
    MoveCommand,
    ParametersCommand,
    RebalanceCommand,
    Refusal,
    ReplaceCommand,
    Result,
    RobotStatus,
    TaskCommand,
    TaskDone,
)
from poise.manage.journal import JournalEntry
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.tasks.task_reports import OVER
from poise.model.robot import Robot
from poise.simulation.choices import Choices
from poise.simulation.component_models import Flaw
from poise.simulation.robot.simulated_robot import SimulatedManager, SimulatedRobot
from poise.wire.codec import pack, unpack
from poise.wire.records.request_records import PortAnswer

T = TypeVar("T")
COMMAND_LIMIT = 60.0
"""An accepted command ends within this time [s]."""
_EVERY, _OFTEN, _MORE_OFTEN = 1.0, 0.2, 0.4
_RUNNING = 0.8
"""How often they mean something that runs."""
_AT_ONCE = 0.3
"""How often another client asks for something at the same moment."""
FLAWS: Mapping[str, Flaw] = {"varied:Failing": "fails", "varied:Crashing": "crashes"}
_CODE = ("varied:Other", "varied:Another", *FLAWS)
_WATCHED = (0.0, 3.0, 10.0)
_COSTS = (0.0, 0.01, 0.1)
_VERBS: tuple[Literal["start", "pause", "resume", "cancel"], ...] = (
    "start",
    "start",
    "pause",
    "resume",
    "resume",
    "cancel",
)


_STARTS = re.compile(r"task '(.+)' starts, with priority")


class Clients:
    """Ask for something each second or so, until `end` [s].

    `names`: of the components that they move.
    `does_all`: whether they also replace, balance, set parameters and command tasks,
    several of them at once; else they only move components.
    """

    def __init__(
        self, robot: SimulatedRobot, names: list[str], end: float, *, does_all: bool
    ) -> None:
        self._robot = robot
        self._names = names
        self._end = end
        self._does_all = does_all
        self._number = 0
        self._asked: dict[str, Command] = {}
        self._done: dict[str, Command] = {}
        self._moved: set[str] = set()
        if does_all:
            robot.on_entry = self._note_entry

    def begin(self, at: float) -> None:
        """Ask first at a moment [s]."""
        self._robot.scheduler.at(at, self._go_on)

    def undone(self, status: RobotStatus) -> list[str]:
        """Return what clients were told is done, and what is not so any more."""
        return [
            f"{command} was done, and is not any more"
            for what, command in self._done.items()
            if self._asked[what] is command and not _is_so(command, status)
        ]

    def _go_on(self) -> None:
        robot, choices = self._robot, self._robot.choices
        if robot.scheduler.now >= self._end:
            return
        self.begin(robot.scheduler.now + _EVERY)
        often = _MORE_OFTEN if self._does_all else _OFTEN
        manager, wants = robot.manager, choices.happens("clients", often)
        if not wants or manager is None or manager.manager is None:
            return
        if not self._does_all:
            self._ask(manager, _some_move(robot.robot, self._names, choices))
            return
        is_more = True
        while is_more:
            self._number += 1
            command = self._some_command(manager)
            self._ask(manager, command)
            if isinstance(command, MoveCommand):
                robot.on_moment("command", command.computer)
            elif isinstance(command, ReplaceCommand) and _breaks(command):
                robot.ledger.is_whole = False
            is_more = choices.happens("clients", _AT_ONCE)

    def _note_entry(self, entry: JournalEntry) -> None:
        """Let all begin anew where somebody started a robot that had no task at work.

        Epochs do, and its tasks run, whatever clients asked for before; so does a task
        that the next manager is started with.
        """
        if begun := _STARTS.match(entry.what):
            self._done.pop(begun[1], None)
        if entry.what.startswith("starting "):
            self._done.clear()
            for name in self._moved:
                self._robot.ledger.commit(name, 0)

    def _some_command(self, manager: SimulatedManager) -> Command:
        """Return what one asks for, most often about what runs."""
        live, names = manager.live, self._names
        if live is not None and self._robot.choices.happens("clients", _RUNNING):
            names = sorted(live.placed) or names
        choices = self._robot.choices
        return some_command(self._robot.robot, names, choices, self._number)

    def _ask(self, manager: SimulatedManager, command: Command) -> None:
        robot = self._robot
        said = _short(command)
        robot.note("client", said)
        self._asked[_about(command)] = command
        is_done = False

        def take(result: Result | Refusal) -> None:
            nonlocal is_done
            is_done = True
            robot.note("client", f"{said}: {str(result)[:120]}")
            self._judge(manager, command, result)

        def look() -> None:
            if not is_done and not manager.process.is_dead:
                what = f"{command} after {COMMAND_LIMIT:g} s"
                robot.ledger.violate("commands-end", what)

        manager.ask(command, take)
        robot.scheduler.at(robot.scheduler.now + COMMAND_LIMIT, look)

    def _judge(
        self, manager: SimulatedManager, command: Command, result: Result | Refusal
    ) -> None:
        """See that what is said to be done is, and that nothing fails without cause."""
        ledger = self._robot.ledger
        is_done = isinstance(result, PortAnswer) and result.outcome == "done"
        if is_done or isinstance(result, TaskDone):
            self._done[_about(command)] = command
        name = _component_of(command)
        if not name or not isinstance(result, MigrationReport):
            return
        assert manager.live is not None
        placed = manager.live.placed.get(name)
        if placed is None:  # its action has ended
            return
        if result.committed:
            self._moved.add(name)
            ledger.commit(name, placed.epoch)
        elif ledger.is_whole and not self._does_all:  # else a task may end it
            ledger.violate("moves-succeed", f"{command}: {result.reason}")


def _component_of(command: Command) -> str:
    """Return which component gets another incarnation; empty: several, or none."""
    match command:
        case MoveCommand(component):
            return component
        case ReplaceCommand(component, by, watch=0.0) if ":" in by:
            return component
    return ""


def _some_move(robot: Robot, names: list[str], choices: Choices) -> MoveCommand:
    computers = sorted(computer.name for computer in robot.computers)
    return MoveCommand(_one(choices, names), _one(choices, computers))


def some_command(
    robot: Robot, names: list[str], choices: Choices, number: int
) -> Command:
    """Return what a client may ask for."""
    happens = partial(choices.happens, "clients")
    kind = choices.draw("clients")
    if kind < 0.3:
        move = _some_move(robot, names, choices)
        return MoveCommand(
            move.component, move.computer, force=happens(0.2), dry=happens(0.1)
        )
    if kind < 0.45:
        by, watch = _one(choices, _CODE), _one(choices, _WATCHED)
        return ReplaceCommand(_one(choices, names), by, fresh=happens(0.3), watch=watch)
    if kind < 0.6:
        what = robot.architecture_of(_one(choices, names)).name
        if others := _others(robot, what):
            by = _one(choices, others)
            return ReplaceCommand(what, by, fresh=happens(0.5))
    if kind < 0.7:
        return RebalanceCommand(_one(choices, _COSTS), dry=happens(0.2))
    if kind < 0.8:
        component, changes = _one(choices, names), pack({f"p{number}": number})
        return ParametersCommand(component=component, changes=changes, limit=1.0)
    task = _one(choices, [task.name for task in robot.tasks])
    priority = choices.among("clients", 3) if happens(0.3) else None
    return TaskCommand(_one(choices, _VERBS), task, priority)


def _about(command: Command) -> str:
    """Return what a command is about: of two about the same, the later counts."""
    return command.task if isinstance(command, TaskCommand) else str(command)


def _is_so(command: Command, status: RobotStatus) -> bool:
    """Return whether what a command has done is so still."""
    if isinstance(command, ParametersCommand):
        set_ = status.parameters.get(command.component, {})
        return bool(unpack(command.changes).items() <= set_.items())
    assert isinstance(command, TaskCommand)
    state = [task.state for task in status.tasks if task.name == command.task]
    match command.verb:
        case "cancel":
            return not state or state[-1] in OVER
        case "pause":
            return bool(state) and state[-1] == "paused"
    return bool(state) and state[-1] != "paused"


def _breaks(command: ReplaceCommand) -> bool:
    """Return whether messages may be lost: code fails, or what waits has no place."""
    return command.by in FLAWS or ":" not in command.by


def _others(robot: Robot, name: str) -> list[str]:
    function = robot.architecture(name).function
    return [
        a.name for a in robot.architectures if a.function == function and a.name != name
    ]


def _one(choices: Choices, of: Sequence[T]) -> T:
    return of[choices.among("clients", len(of))]


def _short(command: Command) -> str:
    if isinstance(command, MoveCommand):
        return f"move {command.component} to {command.computer}"
    return str(command)[:160]
