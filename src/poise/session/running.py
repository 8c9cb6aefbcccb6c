"""A robot that is up, as it is asked for things: from here, or from elsewhere."""

from __future__ import annotations

from typing import TypeVar

from poise.errors import RunError
from poise.manage.control import (
    Answer,
    Ask,
    AskAlternative,
    AskBalance,
    AskMove,
    AskReplace,
    AskStatus,
    AskStop,
    Balanced,
    Moved,
    Replaced,
    RobotStatus,
    Stopping,
    ask,
)
from poise.manage.migration.move import MoveReport
from poise.manage.migration.replacement import ReplaceReport

A = TypeVar("A", bound=Answer)


class Running:
    """A robot that is up.

    Every method raises `UsageError` when the robot's manager refuses, and `RunError`
    when it gives no answer.

    Parameters
    ----------
    name
        The robot's name; None: the only one that runs here.
    """

    def __init__(self, name: str | None = None) -> None:
        self.name = name

    def status(self) -> RobotStatus:
        """Return where components run, and how they and their computers are."""
        return self._ask(AskStatus(), RobotStatus)

    def move(self, component: str, computer: str) -> MoveReport:
        """Move a component to another computer, with its state.

        Raises
        ------
        RunError
            It failed; the component goes on where it was.
        """
        report = self._ask(AskMove(component, computer), Moved).report
        if not report.committed:
            raise RunError(f"{component} stays on {report.source}: {report.reason}")
        return report

    def replace(
        self, what: str, by: str, *, adapt: str = ""
    ) -> MoveReport | ReplaceReport:
        """Swap a component's implementation, or an architecture for another.

        Parameters
        ----------
        what
            A component, or an architecture.
        by
            ``package.module:Class``, or another architecture of the same function.
        adapt
            ``package.module:function`` that maps the old state to the new one.

        Raises
        ------
        RunError
            It failed; all goes on as before.
        """
        report: MoveReport | ReplaceReport
        if ":" in by:
            report = self._ask(AskReplace(what, by, adapt), Moved).report
        else:
            report = self._ask(AskAlternative(what, by, adapt), Replaced).report
        if not report.committed:
            raise RunError(f"{what} is not replaced: {report.reason}")
        return report

    def balance(self, *, cost: float = 0.01, dry_run: bool = False) -> Balanced:
        """Place the robot again, from what its components need now.

        Parameters
        ----------
        cost
            What F grows by for a move, and for each MB of its state.
        dry_run
            Whether to return the proposal only.

        Raises
        ------
        RunError
            A move failed; everything is where it was.
        """
        answer = self._ask(AskBalance(cost, dry_run), Balanced)
        if answer.report is not None and not answer.report.committed:
            raise RunError(f"the robot is as before: {answer.report.reason}")
        return answer

    def stop(self) -> None:
        """Stop the robot; returns before all has ended."""
        self._ask(AskStop(), Stopping)

    def _ask(self, what: Ask, type_: type[A]) -> A:
        answer = ask(self.name, what)
        if not isinstance(answer, type_):
            raise RunError(f"the manager answered {answer!r} to {what!r}")
        return answer


def connect(name: str | None = None) -> Running:
    """Return a robot that another process of this user keeps up, on this computer.

    Parameters
    ----------
    name
        The robot's name; None: the only one that runs here.

    Raises
    ------
    UsageError
        No such robot runs, or several do and none is named.
    """
    running = Running(name)
    running.name = running.status().robot
    return running
