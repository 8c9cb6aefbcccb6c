"""Architectures that a robot file does not contain: in folders and installed packages.

An architecture file has the section `architectures` of a robot file. A Python package
offers the architecture files beside one of its modules by an entry point of the group
`poise.architectures`; nothing of the package is imported to find them.
"""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Iterable, Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from poise.decoding import convert
from poise.errors import FileProblem
from poise.model.file_keys import by_name, says
from poise.model.robot import Architecture, Robot
from poise.model.steps import Action, walk
from poise.model.yaml_tree import Location, Node, read_file
from poise.model.yaml_validation import validate
from poise.units import counted

GROUP = "poise.architectures"
"""The entry points of this group name modules beside which architecture files lie."""


class Place(Struct, frozen=True):
    """A folder of architecture files."""

    folder: str
    named: Location  # where it is named
    package: str = ""  # the installed package that it is in

    def __str__(self) -> str:
        return f"package {self.package}" if self.package else self.folder


class Offer(Struct, frozen=True):
    """An architecture in the repository."""

    place: Place
    architecture: Architecture
    node: Node
    unused: str = ""  # why the robot passes it over
    does_not_fit: bool = False  # whether it is passed over though a task needs it


class Repository(Struct, frozen=True):
    """What was searched, and what was found, in the order of precedence."""

    is_searched: bool = False
    places: tuple[Place, ...] = ()
    offers: tuple[Offer, ...] = ()

    @property
    def functions(self) -> tuple[str, ...]:
        """The functions that are offered."""
        return tuple(dict.fromkeys(o.architecture.function for o in self.offers))

    @property
    def passed_over(self) -> tuple[str, ...]:
        """What does not fit the robot, and so is no alternative, in sentences."""
        return tuple(
            f"architecture '{offer.architecture.name}' ({offer.node.place}) is passed "
            f"over: {offer.unused}"
            for offer in self.offers
            if offer.does_not_fit
        )

    @property
    def searched(self) -> str:
        """Where functions were looked for, as the end of a sentence; empty: nowhere."""
        if not self.is_searched:
            return ""
        files = Counter(offer.place for offer in self.offers)
        places = [f"{p} ({counted(files[p], 'architecture')})" for p in self.places]
        if not any(place.package for place in self.places):
            places.append(f"installed packages (none has the entry point {GROUP})")
        return f"; searched: the robot file, {', '.join(places)}"


class FileKeys(Struct, frozen=True):
    """A file of the repository."""

    architectures: Annotated[
        tuple[Architecture, ...],
        by_name(Architecture),
        says("Architectures by name, as in a robot file.", is_required=True),
    ]


def with_repository(
    robot: Robot, root: Node, problems: list[FileProblem]
) -> tuple[Robot, Repository]:
    """Return the robot with what the repository provides, and what was searched.

    Every architecture in the robot's folders whose function a task names joins the
    robot's own; so does one of an installed package, if the robot file itself does not
    provide the function. Of a name, the first one counts: the robot file's, then
    folders in order, then packages.
    """
    functions = {a.function for a in robot.architectures}
    if not robot.repository and wanted_by(robot) <= functions:
        return robot, Repository()
    repository = search(robot.repository, problems, _items(root, "repository"))
    repository = replace(
        repository, offers=tuple(_fitting(robot, _wanted(robot, repository.offers)))
    )
    used = [offer for offer in repository.offers if not offer.unused]
    nodes = _entries(root, "architectures")
    nodes.update({offer.architecture.name: offer.node for offer in used})
    chosen = tuple(offer.architecture for offer in used)
    return replace(robot, architectures=(*robot.architectures, *chosen)), repository


def wanted_by(robot: Robot) -> set[str]:
    """Return the functions that tasks name."""
    steps = (step for task in robot.tasks for _, step in walk(task))
    return {f for step in steps if isinstance(step, Action) for f in step.functions}


def search(
    folders: Iterable[str], problems: list[FileProblem], where: Iterable[Location]
) -> Repository:
    """Return the architectures in these folders, and in installed packages."""
    places = list(map(Place, folders, where))
    places += _installed(problems)
    offers = [offer for place in places for offer in _offers(place, problems)]
    return Repository(True, tuple(places), tuple(offers))


def _wanted(robot: Robot, offers: Iterable[Offer]) -> Iterator[Offer]:
    """Pass over what no task needs, and what an earlier one of its name hides."""
    own = {a.function for a in robot.architectures}
    wanted = wanted_by(robot)
    first = {a.name: "the robot file" for a in robot.architectures}
    for offer in offers:
        a = offer.architecture
        unused = ""
        if a.name in first:
            unused = f"hidden by that of {first[a.name]}"
        elif a.function not in wanted:
            unused = "no task names its function"
        elif a.package and a.function in own:
            unused = "the robot file provides its function"
        first.setdefault(a.name, a.file)
        yield replace(offer, unused=unused)


def _fitting(robot: Robot, offers: Iterable[Offer]) -> Iterator[Offer]:
    """Pass over what needs something that the robot lacks, if others do not."""
    offers = tuple(offers)
    lacks = [_lacking(robot, offer.architecture) for offer in offers]
    provided = {a.function for a in robot.architectures} | {
        offer.architecture.function
        for offer, lack in zip(offers, lacks, strict=True)
        if not (offer.unused or lack)
    }
    for offer, lack in zip(offers, lacks, strict=True):
        if lack and not offer.unused and offer.architecture.function in provided:
            unused = f"the robot has no {lack}"
            yield replace(offer, unused=unused, does_not_fit=True)
        else:
            yield offer


def _lacking(robot: Robot, architecture: Architecture) -> str:
    """Return what an architecture needs and the robot lacks; empty: it has all."""
    computers = {computer.name for computer in robot.computers}
    devices = {device.name for device in robot.devices}
    resources = {r for computer in robot.computers for r in computer.capacity}
    if architecture.home is not None and architecture.home not in computers:
        return f"computer '{architecture.home}'"
    for component in architecture.components:
        needs = (
            ("device", component.devices, devices),
            ("computer", component.only, computers),
            ("resource", component.demand, resources),
        )
        for kind, names, there in needs:
            for name in names:
                if name not in there:
                    return f"{kind} '{name}'"
    return ""


def _offers(place: Place, problems: list[FileProblem]) -> Iterator[Offer]:
    first: dict[str, Location] = {}
    for path in _yaml_files(place, problems):
        root = read_file(path, None, problems)
        if root is None or (isinstance(root.value, dict) and "robot" in root.value):
            continue  # a robot file may lie beside
        values = validate(root, msgspec.inspect.type_info(FileKeys), problems)
        if values is None:
            continue
        nodes = _entries(root, "architectures")
        for a in convert(values, FileKeys).architectures:
            here = nodes[a.name].place
            if a.name in first:
                twice = f"is defined twice, first at {first[a.name]}"
                problems.append(here.problem(f"architectures.{a.name} {twice}"))
            first.setdefault(a.name, here)
            full = replace(a, file=str(path.resolve()), package=place.package)
            yield Offer(place, full, nodes[a.name])


def _yaml_files(place: Place, problems: list[FileProblem]) -> list[Path]:
    try:
        paths = [*Path(place.folder).iterdir()]
    except OSError as error:
        text = f"the folder {place.folder!r} cannot be read: {error.strerror}"
        problems.append(place.named.problem(f"repository: {text}"))
        return []
    return sorted(path for path in paths if path.suffix in {".yaml", ".yml"})


def _installed(problems: list[FileProblem]) -> Iterator[Place]:
    """Yield the folders of installed packages, by the names of the packages."""
    points = {
        (f"{point.dist.name} {point.dist.version}" if point.dist else point.name, point)
        for point in entry_points(group=GROUP)
    }
    for package, point in sorted(points):
        named = Location(f"package {package}", 0, 0)
        if folder := _folder_of(point):
            yield Place(str(folder), named, package)
        else:
            text = f"its entry point '{point.name}' of {GROUP} names '{point.value}', "
            problems.append(named.problem(f"{text}which is no Python package"))


def _folder_of(point: EntryPoint) -> Path | None:
    """Return the folder of the package that an entry point names; nothing is run."""
    top, *inner = point.value.strip().split(".")
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:  # it is no name
        return None
    for location in (spec and spec.submodule_search_locations) or ():
        if (folder := Path(location, *inner)).is_dir():
            return folder
    return None


def _entries(root: Node, name: str) -> dict[str, Node]:
    """Return the entries of a section of a valid file; it is added when missing."""
    assert isinstance(root.value, dict)  # noqa: S101, it was validated
    section = root.value.setdefault(name, Node(root.place, {})).value
    assert isinstance(section, dict)  # noqa: S101, it was validated
    return section


def _items(root: Node, name: str) -> list[Location]:
    """Return where the items of a list in a valid file are; none when it is missing."""
    assert isinstance(root.value, dict)  # noqa: S101, it was validated
    items = root.value[name].value if name in root.value else []
    assert isinstance(items, list)  # noqa: S101, it was validated
    return [item.place for item in items]
