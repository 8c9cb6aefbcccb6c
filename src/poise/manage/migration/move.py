"""Moves one component to another computer, or replaces its implementation.

A component in Python takes its state along, and loses no call or message. A
command-line component makes a cold move: it is stopped, and started at the target.
"""

from __future__ import annotations

from msgspec import structs

from poise.errors import UsageError
from poise.manage.deployment import Incarnation
from poise.manage.journal import Kind
from poise.manage.migration.cold_move import cold_move
from poise.manage.migration.coordinator import (
    MigrationCoordinator,
    MigrationReport,
    describe,
)
from poise.manage.migration.plan import MigrationPlan
from poise.manage.run import Run
from poise.model.check.hosts import allowed_hosts
from poise.model.robot import Component


class MoveReport(MigrationReport, frozen=True, kw_only=True):
    """How the move of a component went, or its replacement on its computer.

    Parameters
    ----------
    source, target
        The computers from which it was to go, and to which.
    cold
        Whether it was stopped and started, as command-line components are; `downtime`
        is how long it was away then.
    """

    component: str
    source: str
    target: str
    cold: bool = False


def move(run: Run, component: str, computer: str) -> MoveReport:
    """Move a running component to a computer; it stays where it is when that fails.

    Raises
    ------
    UsageError
        There is no such component or computer, or it may not run there.
    """
    old = _placed(run, component)
    _check_target(run, component, computer)
    if old.computer == computer:
        raise UsageError(f"component '{component}' runs on '{computer}' already")
    new = Incarnation(
        component=component,
        computer=computer,
        epoch=run.next_epoch(component),
        goal="inactive",
        implementation=old.implementation,
        gently=True,
    )
    return _migrate(run, old, new)


def replace(
    run: Run,
    component: str,
    implementation: str,
    adapt: str = "",
    *,
    fresh: bool = False,
) -> MoveReport:
    """Swap a running component's implementation for another with fitting ports.

    Parameters
    ----------
    implementation
        ``package.module:Class``.
    adapt
        ``package.module:function`` that turns the old state into the new one; empty:
        the new implementation restores the old one's state as it is.
    fresh
        Whether the state is dropped.

    Raises
    ------
    UsageError
        There is no such component.
    """
    old = _placed(run, component)
    if _component(run, component).command:
        raise UsageError(
            f"component '{component}' is a command line: it has no implementation"
        )
    new = structs.replace(
        old,
        epoch=run.next_epoch(component),
        goal="inactive",
        implementation=implementation,
        adapt=adapt,
        fresh=fresh,
        gently=True,
    )
    return _migrate(run, old, new)


def _migrate(run: Run, old: Incarnation, new: Incarnation) -> MoveReport:
    is_command = bool(_component(run, old.component).command)
    if is_command:
        done = cold_move(run, old, new)
    else:
        what = f"component '{old.component}'"
        plan = MigrationPlan(what=what, sources=(old,), targets=(new,))
        done = MigrationCoordinator(run, plan).run()
    report = MoveReport(
        component=old.component,
        source=old.computer,
        target=new.computer,
        cold=is_command,
        **structs.asdict(done),
    )
    kind: Kind = "done" if report.committed else "failed"
    run.journal.note(kind, _sentence(report), move=report)
    return report


def _placed(run: Run, component: str) -> Incarnation:
    try:
        return run.placed[component]
    except KeyError:
        known = ", ".join(sorted(run.placed))
        raise UsageError(f"no component '{component}' runs ({known} do)") from None


def _check_target(run: Run, component: str, computer: str) -> None:
    known = [each.name for each in run.robot.computers]
    if computer not in known:
        raise UsageError(f"no computer '{computer}' (there are {', '.join(known)})")
    allowed = allowed_hosts(run.robot)[component]
    if computer not in allowed:
        raise UsageError(
            f"component '{component}' may not run on '{computer}', only on "
            f"{' or '.join(allowed) or 'none'}"
        )
    if not _component(run, component).movable:
        raise UsageError(f"component '{component}' is not movable (robot file)")


def _component(run: Run, name: str) -> Component:
    return next(each for each in run.robot.components() if each.name == name)


def _sentence(report: MoveReport) -> str:
    if report.source == report.target:
        done = "replaced" if report.committed else "did not replace"
        down = f"; {describe(report)}"
        why = down if report.committed else f": {report.reason}"
        return f"{done} component '{report.component}' on '{report.source}'{why}"
    way = f"component '{report.component}' from '{report.source}' to '{report.target}'"
    if report.committed and report.cold:
        return f"moved {way} by a cold move; downtime {report.downtime:.2f} s"
    if report.committed:
        return f"moved {way}; {describe(report)}"
    return f"did not move {way}: {report.reason}"
