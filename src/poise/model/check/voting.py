"""Whether a robot can choose its next manager, and where nothing may be placed."""

from __future__ import annotations

from collections.abc import Iterator

from poise.model.check.names import components, each_known
from poise.model.robot import LEAST_VOTES, Robot
from poise.model.yaml_tree import Finding, Path

_ALONE = "leave `manager` out, or add a computer"


def check_voting(robot: Robot) -> Iterator[Finding]:
    """Yield why no manager could follow, and what is placed on a witness."""
    computers = [computer.name for computer in robot.computers]
    yield from each_known(("manager",), "computer", robot.manager or (), computers)
    devices = [device.name for device in robot.devices]
    yield from each_known(("keeps",), "device", robot.keeps, devices)
    yield from _witnesses(robot)
    if robot.standbys:
        yield from _majority(robot)
    elif robot.keeps:
        yield Finding(
            ("keeps",),
            "`keeps` says who goes on with a manager, but no computer may lead: name "
            "some in `manager`",
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
                "a manager is followed by a vote of most computers, and of "
                f"{count} no majority is left when one dies: {_ALONE} that only votes "
                "(`witness: true`), or name in `keeps` the devices whose computer goes "
                "on",
            )
        return
    keepers = {d.computer for d in robot.devices if d.name in robot.keeps}
    if len(keepers) > 1:
        named = " and ".join(sorted(keepers))
        yield Finding(
            ("keeps",), f"the devices are on {named}, and only one can go on alone"
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
    for path, what, name in _placed(robot):
        if name in witnesses:
            yield Finding(
                path, f"{what} '{name}', a witness: it votes, and runs nothing else"
            )


def _placed(robot: Robot) -> Iterator[tuple[Path, str, str]]:
    """Yield each place in the file that needs a computer, with its name."""
    for index, name in enumerate(robot.manager or ()):
        yield ("manager", index), "no standby can wait on", name
    for device in robot.devices:
        path: Path = ("devices", device.name, "computer")
        yield path, f"no component could use device '{device.name}' on", device.computer
    for architecture in robot.architectures:
        if architecture.home is not None:
            path = ("architectures", architecture.name, "home")
            yield path, "nothing can be at home on", architecture.home
    for path, _, component in components(robot):
        for index, name in enumerate(component.only):
            yield (*path, "only", index), f"'{component.name}' cannot run on", name
