"""Asks for the status again and again: nothing that does not work is left out of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

from poise.manage.agent_connections.statuses import connectors_of
from poise.manage.control_socket.commands import RobotStatus
from poise.model.robot import Robot
from poise.simulation.robot.simulated_robot import SimulatedManager, SimulatedRobot

_EVERY = 0.1
_AT_WORK = 1.5
"""What a manager says counts once it has been up, and awake, for this time [s]."""
_WITHIN = 1.2
"""What does not work is told within this time [s]: a second, and two looks."""
_JOINED = 3.5
"""Likewise that a connector is not joined, which may take two seconds."""


def ask_status(
    manager: SimulatedManager, on_result: Callable[[RobotStatus], object]
) -> None:
    """Let a client ask for the status; nobody answers while it is not up."""

    def answer() -> None:
        if manager.manager is not None:
            on_result(manager.manager.status())

    manager.process.spawn("client status", answer)


class StatusWatch:
    """Notes as a violation what a manager leaves out of its status."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._scheduler = robot.scheduler
        self._asked: SimulatedManager | None = None
        self._since: Mapping[str, float] = {}
        self._look()

    def _look(self) -> None:
        now, manager = self._scheduler.now, self._robot.manager
        self._scheduler.at(now + _EVERY, self._look)
        if manager is not self._asked:
            self._asked, self._since = manager, {}
        if manager is not None and not manager.process.is_dead:
            ask_status(manager, partial(self._judge, manager))

    def _judge(self, manager: SimulatedManager, status: RobotStatus) -> None:
        now = self._scheduler.now
        began = max(manager.process.awake_since, manager.up_since)
        # one that was superseded says that it does not know any more
        is_over = any("may be out of date" in d.what for d in status.deviations)
        if manager is not self._robot.manager or now < began + _AT_WORK or is_over:
            self._since = {}
            return
        limits = dict(_untold(self._robot.robot, status))
        self._since = {what: self._since.get(what, now) for what in limits}
        for what, since in self._since.items():
            if now - since >= limits[what]:
                self._robot.ledger.violate("status-tells-all", what)


def _untold(robot: Robot, status: RobotStatus) -> Iterator[tuple[str, float]]:
    """Yield what a status does not say, and how long it may be left out [s]."""
    said = " ".join([*(d.what for d in status.deviations), *status.under_way])
    for computer in robot.computers:
        if computer.name not in status.computers and f"'{computer.name}'" not in said:
            yield f"nothing is said of computer '{computer.name}'", 0.0
    for function in sorted({a.function for a in robot.architectures}):
        begun = [
            a.name
            for a in robot.architectures
            if a.function == function
            and any(c.name in status.placement for c in a.components)
        ]
        if len(begun) > 1:
            yield f"'{function}' is provided by {' and by '.join(begun)}", 0.0
    states = {
        (at, component.name): component.state
        for at, report in status.computers.items()
        for component in report.components
    }
    for name, at in sorted(status.placement.items()):
        state = states.get((at, name), "not there")
        # the sentence for a computer that is out of reach names what ran there
        if state != "active" and f"'{at}'" not in said and name not in said:
            yield f"nothing says that '{name}' on '{at}' is {state}", _WITHIN
    for name, ends in _not_joined(status):
        works = all(states.get((status.placement[n], n)) == "active" for n in ends)
        if works and not any(end in said for end in ends):
            yield f"nothing says that '{name}' is not joined", _JOINED


def _not_joined(status: RobotStatus) -> Iterator[tuple[str, list[str]]]:
    """Yield connectors of which the source says so, and the components they join.

    Not of one that has been started elsewhere since its computer was lost.
    """
    for at, report in status.computers.items():
        here = {name for name, where in status.placement.items() if where == at}
        for connector in connectors_of({at: report}):
            ends = [n for n in status.placement if f"{n}." in connector.name]
            source = connector.name.partition(".")[0]
            is_source = connector.end == "source" and source in here
            if is_source and not connector.ready and len(ends) > 1:
                yield connector.name, ends
