"""Finds the emulated computers that processes of this user keep."""

from __future__ import annotations

from poise.emulate import registry
from poise.emulate.kept.emulated_set import EmulatedSet
from poise.emulate.layout import KeptSet
from poise.errors import UsageError
from poise.model.robot import Robot


def find_set(robot: str | None = None) -> EmulatedSet:
    """Return the emulated computers that a process of this user keeps."""
    found = {each.robot: each for each in all_sets()}
    if robot is None and len(found) == 1:
        return next(iter(found.values()))
    if robot in found:
        return found[robot]
    names = ", ".join(found) or "none"
    if robot is None and found:
        raise UsageError(f"several robots have some ({names}): name one with --robot")
    whose = f"robot '{robot}' has" if robot else "there are"
    raise UsageError(
        f"{whose} no emulated computers that are kept (up: {names}); "
        "`poise emulate FILE` brings them up"
    )


def set_for(robot: Robot) -> EmulatedSet | None:
    """Return the set that a robot is to use; None when none is kept for it."""
    for each in all_sets():
        if each.robot != robot.name:
            continue
        if each.state().hardware == KeptSet.of(robot).hardware:
            return each
        raise UsageError(
            f"process {each.layout.owner.pid} keeps emulated computers of robot "
            f"'{robot.name}' ({', '.join(each.computers)}) that are not those of this "
            f"robot file: `poise emulate stop --robot {robot.name}` ends them; "
            "then `poise emulate FILE` brings these up"
        )
    return None


def all_sets() -> list[EmulatedSet]:
    """Return all sets that processes of this user keep."""
    layouts = registry.kept_sets()
    return [EmulatedSet(layout, layout.kept) for layout in layouts if layout.kept]
