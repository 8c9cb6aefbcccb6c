"""What another manager may run on computers that this one has not claimed. Pure.

A manager that does not reach all agents cannot know what is at work on the others: on
the far side of a cut another manager may have started there what is inactive here. So
it holds such components: they stay inactive, with their state, until it has claimed
these computers, or a person says that it takes over.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from msgspec.structs import replace

from poise.manage.deploy.adoption import Found
from poise.manage.deploy.desired import Desired
from poise.model.check.allowed_computers import allowed_computers
from poise.model.pinned import leased_components
from poise.model.robot import Robot


def components_to_hold(
    robot: Robot,
    found: Sequence[Found],
    claimed: Collection[str],
    fenced: Collection[str],
) -> frozenset[str]:
    """Return the components that may be at work on a computer that is not claimed.

    Parameters
    ----------
    found
        What the claimed agents work towards.
    fenced
        Computers whose lease had ended when they were claimed: what may move is
        inactive there, and may have been started elsewhere.
    """
    missing = {computer.name for computer in robot.computers} - set(claimed)
    goals: dict[str, set[str]] = {}
    for each in found:
        goal = "inactive" if each.computer in fenced else each.spec.goal
        goals.setdefault(each.name, set()).add(goal)
    allowed = allowed_computers(robot)
    return frozenset(
        name
        for name in leased_components(robot)
        if not missing.isdisjoint(allowed[name]) and "active" not in goals.get(name, ())
    )


def where_held(
    robot: Robot,
    starts: Mapping[str, str],
    held: Collection[str],
    claimed: Collection[str],
) -> dict[str, str]:
    """Return component -> computer of what starts.

    What is held counts as placed on a computer that is not claimed.
    """
    allowed = allowed_computers(robot)
    return {
        name: min(set(allowed[name]) - set(claimed)) if name in held else at
        for name, at in starts.items()
    }


def joined_by(
    desired: Desired,
    robot: Robot,
    found: Iterable[Found],
    claimed: Collection[str],
    missing: Collection[str],
    fenced: Collection[str],
) -> Desired:
    """Return what should run when more computers are claimed.

    What is at work there goes on there, unless this manager runs it, or another
    architecture of its function. It is held there when a missing computer may run it,
    as in `components_to_hold`. When none is missing that may run it, what is held is
    active again where it is.

    Parameters
    ----------
    found
        What the agents of these computers work towards.
    claimed
        Computers that were claimed before.
    missing
        Those that are not claimed now, either.
    fenced
        As for `components_to_hold`.
    """
    placed, held = dict(desired.placed), set(desired.held)
    provided = {
        a.function
        for a in robot.architectures
        if not placed.keys().isdisjoint(c.name for c in a.components)
    }
    allowed = allowed_computers(robot)
    for each in sorted(found, key=lambda f: f.spec.epoch):
        before = placed.get(each.name)
        # of what is only held here, the later incarnation counts; what was to start
        # on a computer that was not claimed is not there
        is_later = before is not None and (
            before.computer not in claimed
            or (each.name in held and each.spec.epoch > before.epoch)
        )
        is_lacking = (
            before is None
            and each.computer in allowed.get(each.name, ())
            and robot.architecture_of(each.name).function not in provided
        )
        if each.goal == "active" and (is_later or is_lacking):
            placed[each.name] = each.incarnation
            is_fenced = each.spec.held or (each.computer in fenced and each.spec.leased)
            (held.add if is_fenced else held.discard)(each.name)
    freed = {name for name in held if allowed[name].isdisjoint(missing)}
    return replace(desired, placed=placed, held=frozenset(held - freed))
