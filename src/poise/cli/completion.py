"""What a shell completes: names of what runs here, and of what is in a robot file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from poise.session.running_robots.local_robots import Thing

Complete = Callable[[typer.Context, str], list[str]]


def running(what: Thing) -> Complete:
    """Return what completes the names of things of robots that run here."""

    def complete(context: typer.Context, begun: str) -> list[str]:
        from poise.session.running_robots.local_robots import names_of, robots_here

        robot = None if what == "robots" else context.params.get("robot")
        return _fitting(lambda: names_of(robots_here(robot), what), begun)

    return complete


def in_file(what: str) -> Complete:
    """Return what completes names in the command's robot file.

    Parameters
    ----------
    what
        ``tasks``, ``computers`` or ``components``.
    """

    def complete(context: typer.Context, begun: str) -> list[str]:
        def names() -> Iterable[str]:
            from poise.model import load

            # before an option without a value, arguments are not told from the rest
            robot = load(Path(context.params.get("file") or context.args[0]))
            if what == "tasks":
                return [each.name for each in robot.tasks]
            if what == "computers":
                return [each.name for each in robot.computers]
            return [each.name for each in robot.components()]

        return _fitting(names, begun)

    return complete


def _fitting(names: Callable[[], Iterable[str]], begun: str) -> list[str]:
    """Return the names that begin so; none where the line is not one that works yet."""
    from poise.errors import PoiseError

    try:
        return sorted({name for name in names() if name.startswith(begun)})
    except (PoiseError, OSError, IndexError):
        return []
