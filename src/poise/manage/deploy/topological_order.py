"""In which order components become quiescent. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable


def levels(names: Collection[str], leads: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Return `names` so that each comes before all to which it leads."""
    following: dict[str, set[str]] = {}
    for source, target in leads:
        following.setdefault(source, set()).add(target)
    reached = {name: _reached(name, following) for name in names}
    left, ordered = list(names), []
    while left:
        level = [
            name
            for name in left
            if all(
                name not in reached[other] or other in reached[name] for other in left
            )
        ]
        ordered.append(level)
        left = [name for name in left if name not in level]
    return ordered


def _reached(name: str, following: dict[str, set[str]]) -> set[str]:
    reached: set[str] = set()
    waiting = [name]
    while waiting:
        for target in following.get(waiting.pop(), ()):
            if target not in reached:
                reached.add(target)
                waiting.append(target)
    return reached
