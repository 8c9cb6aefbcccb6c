"""`together` and `apart`: the names exist, and they do not contradict each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

from poise.model.check.allowed_computers import Names, allowed_computers
from poise.model.check.names import check_components_known
from poise.model.robot import Robot
from poise.model.yaml.positions import Finding
from poise.suggest import listed


def check_together_apart(robot: Robot) -> Iterator[Finding]:
    """Yield what is wrong with the sets of components."""
    for section in ("together", "apart"):
        for index, names in enumerate(getattr(robot, section)):
            yield from check_components_known(robot, (section, index), names)
    allowed = allowed_computers(robot)
    yield from _nowhere_together(robot, allowed)
    yield from _not_apart(robot, allowed)


def _groups(robot: Robot) -> Iterator[frozenset[str]]:
    """Yield, for each `together`, the group that it makes with those before it."""
    groups: dict[str, frozenset[str]] = {}
    for names in robot.together:
        merged = frozenset(names).union(*(groups.get(n, ()) for n in names))
        groups.update(dict.fromkeys(merged, merged))
        yield merged


def _nowhere_together(robot: Robot, allowed: Mapping[str, Names]) -> Iterator[Finding]:
    for index, group in enumerate(_groups(robot)):
        limits = {name: allowed[name] for name in sorted(group) if allowed.get(name)}
        if limits and not frozenset.intersection(*limits.values()):
            where = "; ".join(
                f"'{n}' on {listed(sorted(h))}" for n, h in limits.items()
            )
            yield Finding(
                ("together", index), f"no computer may run all of them: {where}"
            )


def _not_apart(robot: Robot, allowed: Mapping[str, Names]) -> Iterator[Finding]:
    groups = tuple(_groups(robot))
    for index, names in enumerate(robot.apart):
        distinct = dict.fromkeys(names)
        if len(distinct) > len(robot.computers):
            yield Finding(
                ("apart", index),
                f"{len(distinct)} components cannot all be on different computers: "
                f"there are only {len(robot.computers)}",
            )
            continue
        for pair in combinations(distinct, 2):
            reason = _why_not_apart(pair, allowed, groups)
            if reason:
                both = f"'{pair[0]}' and '{pair[1]}' must be apart, but {reason}"
                yield Finding(("apart", index), both)


def _why_not_apart(
    pair: tuple[str, str],
    allowed: Mapping[str, Names],
    groups: tuple[frozenset[str], ...],
) -> str:
    """Return why the two cannot be apart, or nothing."""
    if any(group.issuperset(pair) for group in groups):
        return "`together` puts them on one computer"
    common = frozenset.union(*(allowed.get(name, frozenset()) for name in pair))
    if len(common) == 1 and all(allowed.get(name) for name in pair):
        return f"both can run only on '{next(iter(common))}'"
    return ""
