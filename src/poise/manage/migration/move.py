"""Plans the move of a component, its replacement, or that of an architecture.

Each is checked, and returned as a `PendingMigration` to be run. The components of an
architecture take over at once, or none does: it is one migration.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import partial

from msgspec import structs

from poise import plan
from poise.errors import RunError, UsageError
from poise.manage.agent_connections.reports import nothing
from poise.manage.agent_connections.statuses import (
    calling_ports,
    components_of,
    located,
)
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import ACTIVE_LIMIT, READY_LIMIT, LiveRobot
from poise.manage.migration.coordinator import Migration
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.pending_migration import PendingMigration
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Architecture, Robot
from poise.units import named
from poise.wire.records.code_records import SHOWN
from poise.wire.records.request_records import CheckpointCopy


def plan_move(
    live: LiveRobot, component: str, computer: str, *, force: bool = False
) -> PendingMigration:
    """Return the move of a component, to be run; `force`: as of `check_target`."""
    old = check_target(live, component, computer, force=force)
    return _pending(live, old, structs.replace(_next(live, old), computer=computer))


def _next(live: LiveRobot, old: Incarnation) -> Incarnation:
    """Return what takes the place of an incarnation, and goes on from its state."""
    return structs.replace(
        old,
        epoch=live.next_epoch(old.component),
        goal="inactive",
        adapt="",
        fresh=False,
        gently=True,
        follows=True,
    )


def _placed(live: LiveRobot, component: str) -> Incarnation:
    try:
        return live.placed[component]
    except KeyError:
        known = ", ".join(sorted(live.placed)) or "none"
        raise UsageError(
            f"component '{component}' is not running (running: {known})"
        ) from None


def check_target(
    live: LiveRobot, component: str, computer: str, *, force: bool
) -> Incarnation:
    """Return what is to move; UsageError when it may not.

    `force`: whether it may leave a layer that does not move; only people may ask so.
    """
    old = _placed(live, component)
    known = [computer.name for computer in live.robot.computers]
    if computer not in known:
        raise UsageError(f"no computer '{computer}' (there are {', '.join(known)})")
    layer = live.robot.architecture_of(component).layer
    if layer != "sequencing" and not force:
        raise UsageError(
            f"component '{component}' is in the {layer} layer, which does not move; "
            "`--force` moves it anyway"
        )
    allowed = allowed_computers(live.robot, layers_stay=False)[component]
    if computer not in allowed:
        raise UsageError(
            f"component '{component}' may not run on '{computer}', only on "
            f"{' or '.join(sorted(allowed)) or 'none'}"
        )
    if not live.robot.component(component).movable:
        raise UsageError(f"component '{component}' is not movable (robot file)")
    if old.computer == computer:
        raise UsageError(f"component '{component}' runs on '{computer}' already")
    return old


def plan_replacement(
    live: LiveRobot, component: str, by: str, adapt: str = "", *, fresh: bool = False
) -> PendingMigration:
    """Return the swap of an implementation for another, to be run.

    `by`: ``package.module:Class``, or with ``@VERSION`` of deployed code.
    `adapt`: ``package.module:function`` that turns the old state into the new one;
    empty: the new implementation restores the old one's state as it is.
    """
    old = _placed(live, component)
    _check_layer(live.robot.architecture_of(component), f"component '{component}'")
    if live.robot.component(component).command:
        raise UsageError(
            f"component '{component}' is a command line: it has no implementation"
        )
    implementation, at, version = by.partition("@")
    if not (at or old.code):
        _check_not_edited(live, old, implementation)
    new = structs.replace(
        _next(live, old),
        implementation=implementation,
        code=_code(live, old.computer, version) if at else old.code,
        adapt=adapt,
        fresh=fresh,
    )
    return _pending(live, old, new, by)


def _check_not_edited(live: LiveRobot, old: Incarnation, by: str) -> None:
    """Refuse code of which the container has an earlier version."""
    before = old.implementation or live.robot.component(old.component).implementation
    module = by.partition(":")[0]
    if module == before.partition(":")[0] and live.layout.is_edited(old):
        raise UsageError(
            f"the code of component '{old.component}' was edited since it was read, "
            f"and a container imports '{module}' once: `poise up --take-over FILE` "
            "restarts it with the edited code"
        )


def plan_return(live: LiveRobot, before: Incarnation) -> PendingMigration:
    """Return the swap of a component's code for that of an earlier incarnation."""
    old = _placed(live, before.component)
    new = structs.replace(
        _next(live, old), implementation=before.implementation, code=before.code
    )
    entry = live.robot.component(before.component)
    code = (before.code or live.robot.deployed)[:SHOWN]
    by = before.implementation or entry.implementation
    return _pending(live, old, new, f"{by}@{code}" if code else by)


def _code(live: LiveRobot, computer: str, version: str) -> str:
    """Return the version of code that begins so; empty: the robot's own."""
    status = live.agents.statuses().get(computer)
    there = status.code if status is not None else ()
    found = [code for code in there if version and code.startswith(version)]
    if len(found) != 1:
        known = ", ".join(code[: max(SHOWN, len(version))] for code in there) or "none"
        raise UsageError(
            f"'{computer}' has {'more than one' if found else 'no'} version of the "
            f"code that begins with '{version}' (there: {known}): `poise deploy FILE` "
            "sends one"
        )
    return "" if found[0] == live.robot.deployed else found[0]


def _pending(
    live: LiveRobot, old: Incarnation, new: Incarnation, by: str = ""
) -> PendingMigration:
    entry = live.robot.component(old.component)
    found = [c for c in components_of(live.agents.statuses()) if c.name == entry.name]
    has_state = any(c.has_state for c in found)
    # then there is no state to be transferred
    has_failed = any(c.epoch == old.epoch and c.state == "failed" for c in found)
    report = MigrationReport(
        what=old.component,
        by=by,
        before={old.component: old.computer},
        after={old.component: new.computer},
        cold=bool(entry.command) or has_failed,
        stateless=entry.ros2 is not None and not (entry.command or has_state),
    )
    if has_failed and new.adapt:
        raise UsageError(
            f"component '{old.component}' has failed, and --adapt maps the state of "
            "one that works: without it, the new code begins from the last checkpoint"
        )
    if report.cold:
        restart = _restart_failed if has_failed else _move_cold
        return PendingMigration(
            live, report, (), (), lambda: restart(live, report, old, new)
        )
    return _live_migration(live, report, (old,), (new,))


def _live_migration(
    live: LiveRobot,
    report: MigrationReport,
    sources: tuple[Incarnation, ...],
    targets: tuple[Incarnation, ...],
) -> PendingMigration:
    return PendingMigration(
        live,
        report,
        sources,
        targets,
        lambda: Migration(live, report, sources, targets).run(),
    )


def _move_cold(
    live: LiveRobot, report: MigrationReport, old: Incarnation, new: Incarnation
) -> MigrationReport:
    """Stop a command and start it elsewhere, or here again.

    Its process has no state that could be transferred, and must not run twice. So the
    target is prepared first; then the component is away for a moment.
    """
    started = time.monotonic()
    try:
        live.bring([new], READY_LIMIT, f"prepare the cold move of {report.name}")
    except RunError as error:
        desired = live.desired.with_coming(())
        live.commit(desired, f"the cold move of {report.name} is rolled back: {error}")
        report = structs.replace(report, reason=str(error))
    prepared = time.monotonic() - started
    if not report.reason:
        report = _restart(live, report, old, new)
    return structs.replace(report, phases={"prepare": prepared})


def _restart_failed(
    live: LiveRobot, report: MigrationReport, old: Incarnation, new: Incarnation
) -> MigrationReport:
    """Restart what has failed, from its checkpoint unless it is to begin fresh."""
    kept = live.agents.checkpoints.get(*old.key)
    if not new.fresh:
        new = _with_checkpoint(live, new, kept)
    return _restart(live, report, old, new, kept)


def _with_checkpoint(
    live: LiveRobot, new: Incarnation, kept: CheckpointCopy | None
) -> Incarnation:
    new, note = hand_checkpoint(live, new, kept)
    note()
    return new


def hand_checkpoint(
    live: LiveRobot, new: Incarnation, kept: CheckpointCopy | None
) -> tuple[Incarnation, Callable[[], None]]:
    """Let its agent keep the state to go on from; return it, and what journals that."""
    if kept is None:
        return structs.replace(new, fresh=True), nothing
    mine = structs.replace(kept, epoch=new.epoch)
    refusal = live.agents.keep_checkpoint(new.computer, mine)
    note = partial(live.note_checkpoint, new.computer, mine, refusal)
    return structs.replace(new, fresh=bool(refusal)), note


def _restart(
    live: LiveRobot,
    report: MigrationReport,
    old: Incarnation,
    new: Incarnation,
    kept: CheckpointCopy | None = None,
) -> MigrationReport:
    """End one that has no state, or has failed; start the next, or again that one."""
    began, reason = time.monotonic(), ""
    what, active = f"cold move of '{old.component}'", new.with_goal("active")
    try:
        # the two must not run at the same time
        desired = live.desired.without([old.component]).with_coming([new])
        live.commit(desired, f"{what}: it ends where it was")
        live.wait_ended(old)
        live.bring([active], ACTIVE_LIMIT, f"{what}: it starts")
    except RunError as error:
        reason = str(error)
        again = structs.replace(old, epoch=live.next_epoch(old.component))
        again = _with_checkpoint(live, again, kept)
        desired = live.desired.with_coming(()).placing([again])
        live.commit(desired, f"{what} is rolled back: {reason}")
    else:
        live.commit(live.desired.placing([active]), f"{what} is committed")
    away = time.monotonic() - began
    return structs.replace(report, committed=not reason, reason=reason, downtime=away)


def plan_alternative(
    live: LiveRobot, architecture: str, by: str, adapt: str = "", *, fresh: bool = False
) -> PendingMigration:
    """Return the replacement of an architecture by another, to be run.

    What waits at its ports goes to the alternative where the same source is joined to
    both; messages that are under way within it end with it.

    `fresh`: whether they begin without state; else `adapt` is needed where there is
    any.
    """
    old, new = _checked(live, architecture, by)
    if not adapt and not fresh:
        _check_stateless(live, old)
    where = _placement(live, old, new)
    sources = tuple(live.placed[component.name] for component in old.components)
    targets = tuple(
        structs.replace(
            live.begun(component.name, where[component.name]),
            goal="inactive",
            adapt=adapt,
            fresh=fresh,
            gently=True,
        )
        for component in new.components
    )
    report = MigrationReport(
        what=architecture,
        by=by,
        before={incarnation.component: incarnation.computer for incarnation in sources},
        after=where,
    )
    return _live_migration(live, report, sources, targets)


def _checked(live: LiveRobot, name: str, by: str) -> tuple[Architecture, Architecture]:
    old, new = _architecture(live.robot, name), _architecture(live.robot, by)
    missing = [c.name for c in old.components if c.name not in live.placed]
    if missing or not old.components:
        raise UsageError(
            f"architecture '{name}' does not run (not running: {', '.join(missing)})"
        )
    if new.function != old.function:
        raise UsageError(
            f"architecture '{by}' provides '{new.function}', not '{old.function}': "
            f"it is not an alternative to '{name}'"
        )
    for architecture in (old, new):
        _check_layer(architecture, f"architecture '{architecture.name}'")
    if any(c.name in live.placed for c in new.components):
        raise UsageError(f"architecture '{by}' runs already")
    commands = [c.name for c in (*old.components, *new.components) if c.command]
    if commands:
        raise UsageError(
            f"{named('executable', commands)} cannot take over state: "
            "stop the robot, and start it with the other architecture"
        )
    _check_callers(live, old, new)
    return old, new


def _check_layer(architecture: Architecture, what: str) -> None:
    if architecture.layer != "sequencing":
        raise UsageError(
            f"{what} is in the {architecture.layer} layer, which stays as it is: stop "
            "the robot to change it"
        )


def _check_stateless(live: LiveRobot, old: Architecture) -> None:
    """Raise UsageError when a component's state would be lost."""
    where = {c.name: live.placed[c.name].computer for c in old.components}
    found = located(live.agents.statuses())
    lost = sorted(
        {c.name for at, c in found if c.has_state and where.get(c.name) == at}
    )
    if lost:
        raise UsageError(
            f"the state of {named('component', lost)} would be lost: map it with "
            "--adapt, or drop it with --fresh"
        )


def _check_callers(live: LiveRobot, old: Architecture, new: Architecture) -> None:
    """Raise UsageError when a caller of `old` could not call `new`."""
    layout = live.layout
    olds, news = (
        {c.name for c in architecture.components} for architecture in (old, new)
    )
    others = live.placed.keys() - olds
    offered = {
        layout.slot_of(connector)
        for connector in layout.connectors({*others, *news})
        if connector.between[1].component in news
    }
    calls = calling_ports(live.agents.statuses())
    for connector in layout.connectors(live.placed):
        source, target = connector.between
        is_call = (source.component, source.port) in calls
        if source.component in olds or target.component not in olds or not is_call:
            continue
        if layout.slot_of(connector) not in offered:
            raise UsageError(
                f"'{source}' calls '{target}', and is joined to nothing in "
                f"architecture '{new.name}': add a connector to the robot file"
            )


def _placement(live: LiveRobot, old: Architecture, new: Architecture) -> dict[str, str]:
    """Return where the new components go, beside all that runs.

    The old ones are still there meanwhile, but compute nothing any more when the new
    ones begin: they need all they have but the CPU.
    """
    goes = {c.name for c in old.components}
    comes = [c.name for c in new.components]
    problem = plan.keep_components(plan.problem_of(live.robot), {*live.placed, *comes})
    away = live.agents.out_of_reach()
    names = tuple(c.name for c in problem.computers)
    components = []
    for component in problem.components:
        allowed = component.only or names
        only = tuple(at for at in allowed if at not in away) or allowed
        if component.name in live.placed:
            only = (live.placed[component.name].computer,)
        pinned = structs.replace(component, only=only)
        if component.name in goes:
            demand = {r: n for r, n in component.demand.items() if r != "cpu"}
            pinned = structs.replace(pinned, demand=demand)
        components.append(pinned)
    problem = structs.replace(problem, components=tuple(components), architectures=())
    result = plan.solve(problem, steps=live.solve_steps)
    if not result.feasible:
        raise UsageError(
            f"architecture '{new.name}' does not fit beside the running components: "
            f"{result.reason}"
        )
    return {name: result.placement[name] for name in comes}


def _architecture(robot: Robot, name: str) -> Architecture:
    with contextlib.suppress(KeyError):
        return robot.architecture(name)
    known = ", ".join(architecture.name for architecture in robot.architectures)
    text = f"robot '{robot.name}' has no architecture '{name}' ({known})"
    if name in {component.name for component in robot.components()}:
        text += "; to swap this component, name its new class, as package.module:Class"
    raise UsageError(text)
