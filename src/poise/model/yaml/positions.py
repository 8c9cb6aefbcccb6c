"""The locations of a robot's parts in its files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import Struct

from poise.errors import FileProblem
from poise.model.yaml.tree import Location, Node

Path = tuple[str | int, ...]
"""Keys and list indices from the top of the merged robot file, such as
``("architectures", "navigator", "components", "localiser", "cpu")``."""


class Finding(Struct, frozen=True):
    """A problem of a robot; `path` is the faulty part."""

    path: Path
    message: str


class Positions:
    """Maps parts of a robot to ``file:line:column``."""

    def __init__(self, root: Node) -> None:
        self._places: Mapping[Path, Location] = dict(_walk(root, ()))

    def at(self, path: Path) -> Location:
        """Return the location of `path`, or of its nearest parent in the file."""
        while path not in self._places:
            path = path[:-1]
        return self._places[path]

    def has(self, path: Path) -> bool:
        """Return whether the file contains `path`."""
        return path in self._places

    def first_key(self, path: Path) -> Location:
        """Return the location of the first key or item under `path`.

        Raises
        ------
        KeyError
            There is none.
        """
        below = [p for p in self._places if p[:-1] == path and len(p) > len(path)]
        if not below:
            raise KeyError(path)
        return min(
            (self._places[each] for each in below), key=lambda p: (p.line, p.column)
        )

    def problem(self, finding: Finding) -> FileProblem:
        """Return the finding with its location in the file."""
        return self.at(finding.path).problem(finding.message)


def _walk(node: Node, path: Path) -> Iterator[tuple[Path, Location]]:
    yield path, node.place
    if isinstance(node.value, dict):
        for key, entry in node.value.items():
            yield from _walk(entry, (*path, key))
    elif isinstance(node.value, list):
        for index, item in enumerate(node.value):
            yield from _walk(item, (*path, index))
