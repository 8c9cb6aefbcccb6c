"""Which architectures a robot may choose from, and which of them ran."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from poise.errors import FileProblem, RobotError
from poise.estimate.architecture_hash import hash_of
from poise.estimate.success.learning import Belief, hash_in
from poise.manage.journal import Journal
from poise.model.load import load_source
from poise.model.repository import search
from poise.model.robot import Architecture, Layer, Robot
from poise.session.placing.placement import Placement


class Listed(Struct, frozen=True, kw_only=True, rename={"where": "from"}):
    """An architecture that a robot has, or could have from the repository.

    Parameters
    ----------
    where
        Its file, line and column.
    package
        The installed package that it is in, with its version.
    hash
        Changes when what it runs does.
    unused
        Why the robot passes it over; empty: it does not.
    """

    function: str
    architecture: str
    where: str
    package: str
    layer: Layer
    quality: float
    hash: str
    components: tuple[str, ...]
    unused: str = ""


class Described(Listed, frozen=True, kw_only=True):
    """The same, with how often actions succeeded with it."""

    learned: tuple[Belief, ...]


def listed(file: Path | None) -> list[Listed]:
    """Return the architectures of a robot and its repository, by function.

    Parameters
    ----------
    file
        The robot file; None: only what is in installed packages.

    Raises
    ------
    RobotError
        A file has a problem; `problems` has all.
    """
    if file is None:
        problems: list[FileProblem] = []
        offers = search((), problems, ()).offers
        if problems:
            raise RobotError(problems=sorted(problems))
        rows = [_row(o.architecture, str(o.node.place), "", ()) for o in offers]
    else:
        source = load_source(file)
        robot, positions = source.robot, source.positions
        folders = (robot.folder, *robot.repository)
        rows = [
            _row(a, str(positions.at(("architectures", a.name))), "", folders)
            for a in robot.architectures
        ]
        rows += [
            _row(o.architecture, str(o.node.place), o.unused, folders)
            for o in source.repository.offers
            if o.unused
        ]
    return sorted(rows, key=lambda row: row.function)


def note_architectures(journal: Journal, robot: Robot, placement: Placement) -> None:
    """Write into the journal which architectures there are, and which of them run."""
    runs = set(placement.architectures.values())
    facts = {
        a.name: {
            "function": a.function,
            "hash": hash_in(robot, a),
            "file": a.file,
            "package": a.package,
            "runs": a.name in runs,
        }
        for a in robot.architectures
    }
    served = [
        f"{each['function']} by '{name}' ({each['hash']}"
        + (f", {each['package'] or each['file']})" if each["file"] else ")")
        for name, each in facts.items()
        if each["runs"]
    ]
    journal.note("decided", f"provided: {'; '.join(served)}", architectures=facts)


def _row(a: Architecture, where: str, unused: str, folders: tuple[str, ...]) -> Listed:
    return Listed(
        function=a.function,
        architecture=a.name,
        where=where,
        package=a.package,
        layer=a.layer,
        quality=a.quality,
        hash=hash_of(a, folders),
        components=tuple(component.name for component in a.components),
        unused=unused,
    )
