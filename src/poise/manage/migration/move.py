"""Moves one component to another computer, or replaces its implementation.

A component in Python takes its state along, and loses no call or message. A
command-line component makes a cold move: it is stopped, and started at the target.
"""

from __future__ import annotations

import time

from msgspec import structs

from poise.errors import RunError, UsageError
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.running_components import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    RunningComponents,
)
from poise.manage.migration.coordinator import Migration
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.planned import Planned
from poise.model.check.allowed_computers import allowed_computers


def move(
    run: RunningComponents, component: str, computer: str, *, force: bool = False
) -> MigrationReport:
    """Move a running component to a computer; it stays where it is when that fails.

    Parameters and errors are those of `plan_move`.
    """
    return plan_move(run, component, computer, force=force).run()


def plan_move(
    run: RunningComponents, component: str, computer: str, *, force: bool = False
) -> Planned:
    """Return the move of a running component to a computer; nothing is begun.

    `force`: whether it goes even when it is in the reactive or the deliberative layer;
    only people may ask so.
    """
    old = _placed(run, component)
    _check_target(run, component, computer, force=force)
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
    return _planned(run, old, new)


def replace(
    run: RunningComponents,
    component: str,
    implementation: str,
    adapt: str = "",
    *,
    fresh: bool = False,
) -> MigrationReport:
    """Swap a running component's implementation for another with fitting ports.

    Parameters and errors are those of `plan_replacement`.
    """
    return plan_replacement(run, component, implementation, adapt, fresh=fresh).run()


def plan_replacement(
    run: RunningComponents,
    component: str,
    implementation: str,
    adapt: str = "",
    *,
    fresh: bool = False,
) -> Planned:
    """Return the swap of an implementation for another; nothing is begun.

    `adapt`: ``package.module:function`` that turns the old state into the new one;
    empty: the new implementation restores the old one's state as it is.
    """
    old = _placed(run, component)
    if (layer := run.robot.architecture_of(component).layer) != "sequencing":
        raise UsageError(
            f"component '{component}' is in the {layer} layer, which stays as it is: "
            "stop the robot to change it"
        )
    if run.robot.component(component).command:
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
    return _planned(run, old, new, implementation)


def _planned(
    run: RunningComponents, old: Incarnation, new: Incarnation, by: str = ""
) -> Planned:
    report = MigrationReport(
        what=old.component,
        by=by,
        before={old.component: old.computer},
        after={old.component: new.computer},
        cold=bool(run.robot.component(old.component).command),
    )
    if report.cold:
        return Planned(run, report, (), lambda: _move_cold(run, report, old, new))
    return Planned(
        run, report, (new,), lambda: Migration(run, report, (old,), (new,)).run()
    )


def _move_cold(
    run: RunningComponents, report: MigrationReport, old: Incarnation, new: Incarnation
) -> MigrationReport:
    """Stop a command and start it elsewhere, or here again.

    Its process has no state that could be transferred, and must not run twice. So the
    target is prepared first; then the component is away for a moment. Never raises for
    a failure; ``downtime`` is how long it was away [s].
    """
    started = time.monotonic()
    try:
        run.bring([new], READY_LIMIT, f"prepare the cold move of {report.name}")
    except RunError as error:
        desired = run.desired.starting(())
        run.commit(desired, f"the cold move of {report.name} is rolled back: {error}")
        phases = {"prepare": time.monotonic() - started}
        return structs.replace(report, reason=str(error), phases=phases)
    stopped = time.monotonic()
    reason = _swap(run, old, new)
    return structs.replace(
        report,
        committed=not reason,
        reason=reason,
        downtime=time.monotonic() - stopped,
        phases={"prepare": stopped - started},
    )


def _swap(run: RunningComponents, old: Incarnation, new: Incarnation) -> str:
    """Return why `old` runs again; empty: `new` runs."""
    what, active = f"cold move of '{old.component}'", new.with_goal("active")
    try:
        # the two must not run at the same time
        desired = run.desired.without([old.component]).starting([new])
        run.commit(desired, f"{what}: it ends where it was")
        run.wait_ended(old)
        run.bring([active], ACTIVE_LIMIT, f"{what}: it starts")
    except RunError as error:
        again = structs.replace(old, epoch=run.next_epoch(old.component))
        desired = run.desired.starting(()).placing([again])
        run.commit(desired, f"{what} is rolled back: {error}")
        return str(error)
    run.commit(run.desired.placing([active]), f"{what} is committed")
    return ""


def _placed(run: RunningComponents, component: str) -> Incarnation:
    try:
        return run.placed[component]
    except KeyError:
        known = ", ".join(sorted(run.placed))
        raise UsageError(f"no component '{component}' runs ({known} do)") from None


def _check_target(
    run: RunningComponents, component: str, computer: str, *, force: bool
) -> None:
    known = [each.name for each in run.robot.computers]
    if computer not in known:
        raise UsageError(f"no computer '{computer}' (there are {', '.join(known)})")
    layer = run.robot.architecture_of(component).layer
    if layer != "sequencing" and not force:
        raise UsageError(
            f"component '{component}' is in the {layer} layer, which does not move; "
            "`--force` moves it nevertheless"
        )
    allowed = allowed_computers(run.robot, layers_stay=False)[component]
    if computer not in allowed:
        raise UsageError(
            f"component '{component}' may not run on '{computer}', only on "
            f"{' or '.join(allowed) or 'none'}"
        )
    if not run.robot.component(component).movable:
        raise UsageError(f"component '{component}' is not movable (robot file)")
