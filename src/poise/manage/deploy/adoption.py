"""What a new manager finds at work, and what of it goes on. Pure.

What another manager may run on a computer that this one does not reach is held: it
stays inactive, with its state, until that is claimed, or a person takes it over.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from typing import Any

from msgspec import Struct, structs
from msgspec.structs import replace

from poise.manage.agent_connections.statuses import Statuses, located
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation
from poise.model.check.allowed_computers import allowed_computers, leased_components
from poise.model.robot import Robot
from poise.wire.records.deployment_records import ComponentSpec, Deployment, Goal


class ReportedIncarnation(Struct, frozen=True, kw_only=True):
    """An incarnation that an agent works towards, as it was told."""

    spec: ComponentSpec
    computer: str
    container: str
    folder: str  # where its implementation is imported from, or a version of code
    code: str = ""  # as of an `Incarnation`
    limits: Mapping[str, float] = {}  # connector -> the time limit of its calls [s]

    @property
    def name(self) -> str:
        """The component's name."""
        return self.spec.name

    @property
    def key(self) -> tuple[str, int]:
        """Component and epoch, which tell it from all others."""
        return self.spec.key

    @property
    def goal(self) -> Goal:
        """What it is to be, when nothing holds it."""
        return "active" if self.spec.held else self.spec.goal

    @property
    def incarnation(self) -> Incarnation:
        """The same, to be active."""
        spec = self.spec
        return Incarnation(
            component=spec.name,
            computer=self.computer,
            epoch=spec.epoch,
            implementation=spec.implementation if spec.instead_of else "",
            code=self.code,
            adapt=spec.adapt,
            fresh=spec.fresh,
            gently=spec.gently,
            actions=spec.actions,
        )


class Adoption(Struct, frozen=True, kw_only=True):
    """What becomes of what was found."""

    kept: Mapping[str, Incarnation]  # component -> its incarnation, which goes on
    restarts: Mapping[str, str]  # component -> what differs from the robot file
    ends: tuple[str, ...]  # components that the task does not need
    starts: Mapping[str, str]
    half_done: tuple[str, ...] = ()


def found_in(deployments: Mapping[str, Deployment]) -> list[ReportedIncarnation]:
    """Return all incarnations that agents work towards, by their deployments."""
    return [
        ReportedIncarnation(
            spec=spec,
            computer=computer,
            container=container.name,
            folder=container.code or container.folder,
            # the component's own is that of the robot
            code=container.code if container.code != spec.code else "",
            limits={
                c.name: c.limit for c in container.connectors if c.source == spec.name
            },
        )
        for computer, deployment in sorted(deployments.items())
        for container in deployment.containers
        for spec in container.components
    ]


def changed_parameters(
    found: Iterable[ReportedIncarnation],
) -> dict[str, Mapping[str, Any]]:
    """Return component -> its parameters that were set since the start, if any."""
    return {
        reported.name: reported.spec.changed_parameters
        for reported in sorted(found, key=lambda f: f.spec.epoch)
        if reported.spec.changed_parameters
    }


def as_committed(
    found: Iterable[ReportedIncarnation],
    statuses: Statuses,
    committed: Collection[tuple[str, int]] = (),
) -> list[ReportedIncarnation]:
    """Return what was found, with targets of moves that work already as active.

    `committed`: targets of which their containers said so; of others, that they work.
    """
    working = {
        (computer, component.name, component.epoch)
        for computer, component in located(statuses)
        if component.state == "active"
    }
    return [
        structs.replace(reported, spec=structs.replace(reported.spec, goal="active"))
        if reported.key in committed
        or (
            reported.spec.goal == "inactive"
            and (reported.computer, reported.name, reported.spec.epoch) in working
        )
        else reported
        for reported in found
    ]


def is_half_done(found: Sequence[ReportedIncarnation], robot: Robot) -> bool:
    """Return whether components have two incarnations, or functions two providers."""
    names = {reported.name for reported in found}
    providers = [
        architecture.function
        for architecture in robot.architectures
        if not names.isdisjoint(c.name for c in architecture.components)
    ]
    return len(names) < len(found) or len(set(providers)) < len(providers)


def adopt(
    found: Sequence[ReportedIncarnation],
    robot: Robot,
    layout: DeploymentLayout,
    wanted: Mapping[str, str],
    *,
    committed: Collection[tuple[str, int]] = (),
    keeps: bool = True,
) -> Adoption:
    """Return what of it goes on, and what starts."""
    counts = authoritative(found, robot, committed)
    if keeps:
        wanted = _with_providers(robot, wanted, counts)
    restarts = dict(differences(counts, robot, layout, wanted))
    kept = {
        n: reported
        for n, reported in counts.items()
        if n in wanted and n not in restarts
    }
    return Adoption(
        kept={name: reported.incarnation for name, reported in kept.items()},
        restarts=restarts,
        ends=tuple(sorted({reported.name for reported in found} - wanted.keys())),
        starts={name: at for name, at in wanted.items() if name not in kept},
        half_done=tuple(_half_done(found, counts)),
    )


def authoritative(
    found: Sequence[ReportedIncarnation],
    robot: Robot,
    committed: Collection[tuple[str, int]] = (),
) -> dict[str, ReportedIncarnation]:
    """Return the one incarnation of each component that counts.

    The source of a migration counts until that is committed, then its target. A source
    is to `stay` or is active; a target is active only when its manager knew of that.
    """
    gone = _replaced(found, robot, committed)
    counts: dict[str, ReportedIncarnation] = {}
    for reported in sorted(found, key=lambda f: f.spec.epoch):
        before = counts.get(reported.name)
        is_target = before is not None and reported.goal == "inactive"
        counts_now = not is_target or reported.key in committed
        if reported.name not in gone and counts_now:
            counts[reported.name] = reported
    return counts


def _replaced(
    found: Sequence[ReportedIncarnation],
    robot: Robot,
    committed: Collection[tuple[str, int]],
) -> set[str]:
    """Return the components of architectures whose function another one provides."""
    found_names = {reported.name for reported in found}
    targets = {name for name, _ in committed}
    best: dict[str, int] = {}
    providers: dict[str, set[str]] = {}
    gone: set[str] = set()
    for architecture in robot.architectures:
        names = {c.name for c in architecture.components} & found_names
        reached = {reported.goal for reported in found if reported.name in names}
        # only sources stay, and only targets are inactive beside them
        rank = 2 if "active" in reached else int("stay" in reached)
        rank = 3 if names & targets else rank
        function = architecture.function
        if names and rank > best.get(function, -1):
            gone |= providers.get(function, set())
            best[function], providers[function] = rank, names
        else:
            gone |= names
    return gone


def _with_providers(
    robot: Robot, wanted: Mapping[str, str], counts: Mapping[str, ReportedIncarnation]
) -> dict[str, str]:
    """Return what is wanted, with architectures that run instead of alternatives."""
    chosen = dict(wanted)
    for running in robot.architectures:
        names = [c.name for c in running.components]
        here = [counts[name].computer for name in names if name in counts]
        others = {
            c.name
            for other in robot.architectures
            if other.function == running.function and other.name != running.name
            for c in other.components
        }
        if here and not others.isdisjoint(chosen):
            chosen = {n: at for n, at in chosen.items() if n not in others}
            chosen |= {n: chosen.get(n, here[0]) for n in names}
    return chosen


def differences(
    counts: Mapping[str, ReportedIncarnation],
    robot: Robot,
    layout: DeploymentLayout,
    wanted: Container[str],
) -> Iterator[tuple[str, str]]:
    """Yield the wanted components that are not as the robot file says, and why."""
    allowed = allowed_computers(robot)
    reasons, stale = {}, {}
    for name in sorted(name for name in counts if name in wanted):
        reported, now = counts[name], _spec_now(counts[name], layout)
        if reported.computer not in allowed[name]:
            reasons[name] = f"it may not run on '{reported.computer}' any more"
            continue
        reasons[name] = "; ".join(_changes(reported, now, layout))
        if _has_other_code(reported, now, robot):
            stale[reported.computer, reported.container] = name
            reasons[name] = reasons[name] or "its code has changed"
    for name, reason in sorted(reasons.items()):
        # what a process has imported stays as it is until that ends
        first = stale.get((counts[name].computer, counts[name].container), "")
        if reason or first:
            yield name, reason or f"it shares a container with '{first}'"


def _spec_now(reported: ReportedIncarnation, layout: DeploymentLayout) -> ComponentSpec:
    """Return what the robot file says of it now, with a class that replaced another."""
    now = layout.component_spec(reported.incarnation)
    if now.instead_of == reported.spec.instead_of:
        return now
    return layout.component_spec(
        structs.replace(reported.incarnation, implementation="")
    )


def _has_other_code(
    reported: ReportedIncarnation, now: ComponentSpec, robot: Robot
) -> bool:
    before, after = (
        spec.implementation.partition(":")[0] for spec in (reported.spec, now)
    )
    is_changed = before == after and reported.spec.code != now.code
    here = reported.code or robot.deployed or robot.folder
    return is_changed or reported.folder != here


_FROM_THE_FILE = {
    "implementation": "implementation",
    "command": "command",
    "environment": "environment",
    "parameters": "parameters",
    "devices": "devices",
    "checkpoint": "checkpoint",
    "restart_when_hung": "restart_when_hung",
    "ends": "ports that end actions",
}
"""What a component is made with, by its field of a `ComponentSpec`."""


def _changes(
    reported: ReportedIncarnation, now: ComponentSpec, layout: DeploymentLayout
) -> Iterator[str]:
    for field, what in _FROM_THE_FILE.items():
        before, after = getattr(reported.spec, field), getattr(now, field)
        if before != after:
            yield f"its {what} changed from {before!r} to {after!r}"
    if reported.spec.chains != now.chains:
        yield "its chains or their deadlines changed"
    if reported.spec.leased != now.leased:
        yield f"it may {'now' if now.leased else 'no longer'} run elsewhere"
    for name, limit in layout.limits_from(reported.name).items():
        if (before := reported.limits.get(name, limit)) != limit:
            yield f"the limit of {name} changed from {before:g} s to {limit:g} s"
    container = layout.container_of(reported.incarnation)
    if reported.container != container:
        yield f"its container changed from '{reported.container}' to '{container}'"


def _half_done(
    found: Sequence[ReportedIncarnation], counts: Mapping[str, ReportedIncarnation]
) -> Iterator[str]:
    for name in sorted({reported.name for reported in found}):
        incarnations = sorted(
            (reported for reported in found if reported.name == name),
            key=lambda f: f.spec.epoch,
        )
        if len(incarnations) > 1 and name in counts:
            source, target = incarnations[0], incarnations[-1]
            way = f"'{name}' from '{source.computer}' to '{target.computer}'"
            done = "finished" if counts[name] is target else "rolled back"
            yield f"the migration of {way} was interrupted, and is {done}"


def components_to_hold(
    robot: Robot,
    found: Sequence[ReportedIncarnation],
    claimed: Collection[str],
    fenced: Collection[str],
) -> frozenset[str]:
    """Return the components that may be at work on a computer that is not claimed."""
    missing = {computer.name for computer in robot.computers} - set(claimed)
    active = {
        reported.name
        for reported in found
        if reported.spec.goal == "active" and reported.computer not in fenced
    }
    allowed = allowed_computers(robot)
    return frozenset(
        name
        for name in leased_components(robot) - active
        if not missing.isdisjoint(allowed[name])
    )


def providers(robot: Robot, components: Container[str]) -> dict[str, str]:
    """Return function -> the architecture of it that has one of some components."""
    return {
        architecture.function: architecture.name
        for architecture in robot.architectures
        if any(c.name in components for c in architecture.components)
    }


def joined_by(
    desired: Desired,
    robot: Robot,
    found: Iterable[ReportedIncarnation],
    claimed: Collection[str],
    missing: Collection[str],
    fenced: Collection[str],
    doubted: Collection[tuple[str, int]] = (),
) -> Desired:
    """Return what should run when more computers are claimed.

    What is at work there goes on there, unless this manager runs it, or runs or starts
    another architecture of its function. It is held there when a missing computer may
    run it, as in `components_to_hold`. When none is missing that may run it, what is
    held is active again where it is.

    `doubted`: targets of half-done moves whose sources were not found; nobody said that
    they were committed. And what is only taken to be somewhere: it was found nowhere.
    """
    placed, held = dict(desired.placed), set(desired.held)
    parameters = dict(desired.parameters)
    coming = {incarnation.component for incarnation in desired.coming}
    provider = {**providers(robot, coming), **providers(robot, placed)}
    homes = {c.name: a for a in robot.architectures for c in a.components}
    allowed = allowed_computers(robot)
    for reported in sorted(found, key=lambda f: f.spec.epoch):
        before, own = placed.get(reported.name), homes.get(reported.name)
        # of what is only held here, the later incarnation counts; what was to start
        # on a computer that was not claimed is not there
        is_later = before is not None and (
            before.computer not in claimed
            or (
                reported.name in held
                and (reported.spec.epoch > before.epoch or before.key in doubted)
            )
        )
        is_lacking = (
            before is None
            and not desired.is_over(*reported.key)
            and own is not None
            and reported.computer in allowed[reported.name]
            # a part of what provides it may have joined before, from another computer
            and provider.get(own.function) in {None, own.name}
        )
        if reported.goal == "active" and (is_later or is_lacking):
            placed[reported.name] = reported.incarnation
            parameters |= changed_parameters([reported])
            is_fenced = reported.spec.held or (
                reported.computer in fenced and reported.spec.leased
            )
            (held.add if is_fenced else held.discard)(reported.name)
    freed = {name for name in held if allowed[name].isdisjoint(missing)}
    return replace(
        desired, placed=placed, held=frozenset(held - freed), parameters=parameters
    )
