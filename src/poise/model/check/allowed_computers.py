"""Where each component may run, and whether computers can choose a next manager."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from itertools import combinations

from poise.errors import listed
from poise.model.check.names import components, mentions
from poise.model.hardware import fits
from poise.model.robot import LEAST_VOTES, Architecture, ComponentEntry, Computer, Robot
from poise.model.yaml_tree import Finding
from poise.units import format_amount

Names = frozenset[str]


Pins = Iterator[tuple[tuple[str, ...], str]]
"""Sets of computers that a component is held to, each with the reason."""


def pins(
    robot: Robot,
    architecture: Architecture,
    component: ComponentEntry,
    *,
    layers_stay: bool = True,
) -> Pins:
    """Yield where a component is held to by the robot file, and why."""
    if component.only:
        yield component.only, f"only {' or '.join(component.only)}"
    places = {device.name: device.computer for device in robot.devices}
    for name in component.devices:
        if name in places:
            yield (places[name],), f"device {name} is on {places[name]}"
        else:  # of a robot that is from no file
            yield (), f"the robot has no device {name}"
    is_fixed = layers_stay and architecture.layer != "sequencing"
    if is_fixed and (home := architecture.home) is not None:
        yield (home,), f"the {architecture.layer} layer stays at its home {home}"


def allowed_computers(robot: Robot, *, layers_stay: bool = True) -> Mapping[str, Names]:
    """Return component -> the computers it may run on; unknown ones hold nothing."""
    hosts = frozenset(computer.name for computer in robot.hosts)
    known = {computer.name for computer in robot.computers}
    return {
        component.name: hosts.intersection(
            *(
                names
                for names, _ in pins(
                    robot, architecture, component, layers_stay=layers_stay
                )
                if not known.isdisjoint(names)
            )
        )
        for _, architecture, component in components(robot)
    }


def check_allowed_computers(robot: Robot) -> Iterator[Finding]:
    """Yield the components whose pins, devices and home leave no computer."""
    known = {computer.name for computer in robot.computers}
    for path, architecture, component in components(robot):
        left, reasons = known, []
        for names, reason in pins(robot, architecture, component):
            if not known.isdisjoint(names):
                left = left.intersection(names)
                reasons.append(reason)
        if not left:
            text = f"component '{component.name}' cannot run on any computer"
            yield Finding(path, f"{text}: {'; '.join(reasons)}")


def check_demands(robot: Robot) -> Iterator[Finding]:
    """Yield demands larger than every computer that is allowed, unless another fits."""
    found: dict[str, list[Finding]] = {a.name: [] for a in robot.architectures}
    for architecture, finding in _too_large(robot):
        found[architecture.name].append(finding)
    can = {a.function for a in robot.architectures if not found[a.name]}
    for architecture in robot.architectures:
        if architecture.function not in can:
            yield from found[architecture.name]


def _too_large(robot: Robot) -> Iterator[tuple[Architecture, Finding]]:
    @cache
    def largest(allowed: Names, resource: str) -> Computer | None:
        computers = (host for host in robot.hosts if host.name in allowed)
        return max(computers, key=lambda host: host.usable(resource), default=None)

    hosts = allowed_computers(robot)
    for path, architecture, component in components(robot):
        for resource, amount in component.demand.items():
            computer = largest(hosts[component.name], resource)
            if computer is None:  # it may run nowhere, which is said already
                continue
            usable = computer.usable(resource)
            if fits(amount, usable):
                continue
            key = () if resource in ("cpu", "memory") else ("resources",)
            text = (
                f"component '{component.name}' needs "
                f"{format_amount(resource, amount)} of {resource}, but the largest "
                f"computer that it may run on, '{computer.name}', has "
                f"{format_amount(resource, usable)} usable (capacity x speed - reserve)"
            )
            yield architecture, Finding((*path, *key, resource), text)


def check_together_apart(robot: Robot) -> Iterator[Finding]:
    """Yield what is wrong with the sets of components."""
    allowed = allowed_computers(robot)
    groups = list(_groups(robot))
    yield from _nowhere_together(groups, allowed)
    yield from _not_apart(robot, groups, allowed)


def _groups(robot: Robot) -> Iterator[frozenset[str]]:
    """Yield, for each `together`, the group that it makes with those before it."""
    groups: dict[str, frozenset[str]] = {}
    for names in robot.together:
        merged = frozenset(names).union(*(groups.get(n, ()) for n in names))
        groups.update(dict.fromkeys(merged, merged))
        yield merged


def _nowhere_together(
    groups: list[Names], allowed: Mapping[str, Names]
) -> Iterator[Finding]:
    for index, group in enumerate(groups):
        limits = {name: allowed[name] for name in sorted(group) if allowed.get(name)}
        if limits and not frozenset.intersection(*limits.values()):
            where = "; ".join(
                f"'{n}' on {listed(sorted(h))}" for n, h in limits.items()
            )
            yield Finding(
                ("together", index), f"no computer may run all of them: {where}"
            )


def _not_apart(
    robot: Robot, groups: list[Names], allowed: Mapping[str, Names]
) -> Iterator[Finding]:
    for index, names in enumerate(robot.apart):
        distinct = dict.fromkeys(names)
        if len(distinct) > len(robot.hosts):
            yield Finding(
                ("apart", index),
                f"{len(distinct)} components cannot all be on different computers: "
                f"there are only {len(robot.hosts)}",
            )
            continue
        for one, two in combinations(distinct, 2):
            both = f"'{one}' and '{two}' must be apart, but"
            here = allowed.get(one)
            if any(group.issuperset((one, two)) for group in groups):
                text = f"{both} `together` puts them on one computer"
                yield Finding(("apart", index), text)
            elif here and len(here) == 1 and here == allowed.get(two):
                text = f"{both} both can run only on '{next(iter(here))}'"
                yield Finding(("apart", index), text)


def check_checkpoints(robot: Robot) -> Iterator[Finding]:
    """Yield command lines with a checkpoint, or whose hangs would be noticed."""
    for path, _, component in components(robot):
        for key in ("checkpoint", "restart_when_hung"):
            if component.command and getattr(component, key):
                yield Finding(
                    (*path, key),
                    f"component '{component.name}' is a command line: Poise neither "
                    f"knows its state nor what it does, so leave out `{key}`",
                )


def pinned_components(robot: Robot) -> Mapping[str, str]:
    """Return component -> why it stays on its computer, of those that do."""
    allowed = allowed_computers(robot)
    pinned = {}
    for _, architecture, component in components(robot):
        choices = sorted(allowed[component.name])
        if architecture.layer != "sequencing":
            why = f"it belongs to the {architecture.layer} layer, which stays"
        elif not component.movable:
            why = "it is not movable (robot file)"
        elif len(choices) < 2:  # noqa: PLR2004
            why = f"it may run on {' or '.join(choices)} only"
        else:
            continue
        pinned[component.name] = why
    return pinned


def leased_components(robot: Robot) -> frozenset[str]:
    """Return the components that are inactive while their computer is cut off."""
    pinned = pinned_components(robot)
    return frozenset(
        component.name
        for component in robot.components()
        if component.name not in pinned
        and (component.when_cut_off or robot.when_cut_off) == "stop"
    )


_ALONE = "leave `manager` out, or add a computer"


def check_voting(robot: Robot) -> Iterator[Finding]:
    """Yield why no manager could follow, and what is placed on a witness."""
    yield from _witnesses(robot)
    if robot.standbys:
        yield from _majority(robot)
    elif robot.keeps:
        yield Finding(
            ("keeps",),
            "`keeps` decides which computer continues alone, but no computer may have "
            "the manager: name some in `manager`",
        )


def notes_of(robot: Robot) -> tuple[str, ...]:
    """Return what a person should know of the votes of a robot without findings."""
    if not robot.keeps:
        return ()
    keeper = robot.device(robot.keeps[0]).computer
    others = " and ".join(c.name for c in robot.computers if c.name != keeper)
    note = (
        f"when {others} cannot be reached, {keeper} goes on, for it has "
        f"{', '.join(robot.keeps)}; when {keeper} cannot be reached, nobody leads "
        "until it is back"
    )
    return (note,)


def _majority(robot: Robot) -> Iterator[Finding]:
    count = len(robot.computers)
    if not robot.keeps:
        if count < LEAST_VOTES:
            yield Finding(
                ("manager",),
                "a new manager needs the votes of most computers, and of "
                f"{count} no majority is left when one dies: {_ALONE} that only votes "
                "(`witness: true`), or name in `keeps` the devices whose computer "
                "continues alone",
            )
        return
    keepers = {d.computer for d in robot.devices if d.name in robot.keeps}
    if len(keepers) > 1:
        named = " and ".join(sorted(keepers))
        yield Finding(
            ("keeps",), f"the devices are on {named}, and only one can continue alone"
        )
    if count % 2:
        yield Finding(
            ("keeps",),
            f"of {count} computers a majority goes on, whatever it has: remove `keeps`",
        )


def _witnesses(robot: Robot) -> Iterator[Finding]:
    witnesses = {computer.name for computer in robot.computers if computer.witness}
    for name in sorted(witnesses):
        if not robot.standbys:
            yield Finding(
                ("computers", name, "witness"),
                f"'{name}' votes for the next manager, but no computer may lead: name "
                "some in `manager`",
            )
    if not robot.hosts:
        yield Finding(("computers",), "all computers are witnesses: none runs anything")
    for path, kind, name in mentions(robot):
        if kind == "computer" and name in witnesses and path[0] != "links":
            text = f"'{name}' is a witness: it votes for the manager, and runs nothing"
            yield Finding(path, text)
