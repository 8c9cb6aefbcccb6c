"""Parses YAML text into a tree of nodes, each with its location in the file.

A scalar stays text until the type of its field gives it a meaning, so that
`address: 10.0` and a computer called `on` stay texts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import yaml
from msgspec import Struct
from yaml.reader import ReaderError

from poise.errors import FileProblem
from poise.units import quoted

DEEPEST = 40
"""[levels] Deeper nesting is an error."""
MOST = 100_000
"""[values] More of them in one file, after aliases are expanded, are an error."""
_TAGS = {"str", "int", "float", "bool", "null", "timestamp", "merge", "value"}
_NO_TEXT = re.compile("[\0\ud800-\udfff]")
_YAML = "tag:yaml.org,2002:"


class Location(Struct, frozen=True):
    """A location in a file; `line` and `column` count from 1."""

    file: str
    line: int
    column: int

    def problem(self, message: str) -> FileProblem:
        """Return a problem at this place."""
        return FileProblem(self.file, self.line, self.column, message)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


class Scalar(Struct, frozen=True):
    """A single value: its text, and whether it was written without quotes."""

    text: str
    plain: bool


class Node(Struct):
    """A value in the file: a mapping, a list or a scalar.

    `place` is the location of its key, or of the value when it has no key.
    """

    place: Location
    value: dict[str, Node] | list[Node] | Scalar


class _Bad(Exception):
    """The text cannot be made into a tree."""

    def __init__(self, problem: FileProblem) -> None:
        super().__init__(problem)
        self.problem = problem


def parse(text: str, file: str, problems: list[FileProblem]) -> Node | None:
    """Return the tree of a YAML text, or None when it cannot be parsed.

    Every problem is added to `problems`: syntax, duplicate keys, tags, nesting
    deeper than `DEEPEST`, and more than `MOST` values.
    """
    try:
        return _Converter(file, problems).node(_compose(text, file), None, 0)
    except _Bad as error:
        problems.append(error.problem)
        return None


def _compose(text: str, file: str) -> yaml.Node:
    try:
        loader = _Loader(text, file)
    except ReaderError as error:
        before = text[: error.position]
        column = error.position - before.rfind("\n")
        place = Location(file, before.count("\n") + 1, column)
        raise _Bad(place.problem(f"not YAML: {error.reason}")) from error
    try:
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        raise _Bad(_syntax_problem(error, file)) from error
    except (ValueError, OverflowError) as error:
        # PyYAML raises these for some escapes, such as "\UFFFFFFFF".
        place = _place(file, loader.get_mark())
        raise _Bad(place.problem(f"not YAML: {error}")) from error
    if root is None:
        raise _Bad(Location(file, 1, 1).problem("the file is empty"))
    return root


class _Loader(yaml.SafeLoader):
    """A safe loader that returns nodes only, and rejects deep nesting."""

    def __init__(self, text: str, file: str) -> None:
        super().__init__(text)
        self._file = file
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._depth += 1
        if self._depth > DEEPEST:
            place = _place(self._file, self.peek_event().start_mark)  # type: ignore[no-untyped-call]
            raise _Bad(place.problem(f"nested more than {DEEPEST} levels deep"))
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _Converter:
    """Turns PyYAML's nodes into ours."""

    def __init__(self, file: str, problems: list[FileProblem]) -> None:
        self._file = file
        self._problems = problems
        self._count = 0

    def node(self, source: yaml.Node, key: yaml.Node | None, depth: int) -> Node:
        place = _place(self._file, (key or source).start_mark)
        self._count += 1
        if self._count > MOST or depth > DEEPEST:
            raise _Bad(place.problem(f"more than {MOST} values or {DEEPEST} levels"))
        if isinstance(source, yaml.MappingNode):
            return Node(place, dict(self._entries(source, depth)))
        if isinstance(source, yaml.SequenceNode):
            return Node(place, [self.node(s, None, depth + 1) for s in source.value])
        self._check_scalar(source, place)
        plain = isinstance(source, yaml.ScalarNode) and source.style is None
        return Node(place, Scalar(source.value, plain))

    def _entries(
        self, source: yaml.MappingNode, depth: int
    ) -> Iterator[tuple[str, Node]]:
        first: dict[str, Location] = {}
        for key, value in source.value:
            place = _place(self._file, key.start_mark)
            if not isinstance(key, yaml.ScalarNode):
                self._problems.append(
                    place.problem("a key must be a word, not a list or mapping")
                )
                continue
            self._check_scalar(key, place)
            if key.value in first:
                self._problems.append(
                    place.problem(
                        f"the key {quoted(key.value)} is defined twice, "
                        f"first at {first[key.value]}"
                    )
                )
            else:
                first[key.value] = place
                yield key.value, self.node(value, key, depth + 1)

    def _check_scalar(self, source: yaml.Node, place: Location) -> None:
        if _NO_TEXT.search(source.value):
            text = quoted(source.value)
            self._problems.append(
                place.problem(f"{text} contains a character that is not allowed")
            )
        if source.tag.removeprefix(_YAML) not in _TAGS:
            tag = quoted(source.tag)
            self._problems.append(place.problem(f"YAML tags are not supported: {tag}"))


def _place(file: str, mark: yaml.Mark) -> Location:
    return Location(file, mark.line + 1, mark.column + 1)


def _syntax_problem(error: yaml.MarkedYAMLError, file: str) -> FileProblem:
    mark = error.problem_mark or error.context_mark
    place = _place(file, mark) if mark else Location(file, 1, 1)
    parts = [error.context, error.problem]
    return place.problem("not YAML: " + ", ".join(p for p in parts if p))


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
        """Return the location of the first key or item under `path`."""
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


_VALUE = r"(\s*:\s*)(\"[^\"]*\"|'[^']*'|[^,}#\n]*?)(?=\s*(?:[,}#]|$))"


def with_values(
    texts: Mapping[str, str],
    positions: Positions,
    path: Path,
    values: Mapping[str, str],
) -> dict[str, str]:
    """Return the files' texts with `values` under the mapping at `path`.

    An existing key gets the new value in place. New keys are inserted before the first
    key of the mapping, in the same style.
    """
    lines = {file: text.splitlines(keepends=True) for file, text in texts.items()}
    first = positions.first_key(path)
    here = positions.at(path)
    new = {k: v for k, v in values.items() if not positions.has((*path, k))}
    # from right to left, so that the remaining locations stay valid
    kept = [(positions.at((*path, key)), key) for key in values if key not in new]
    for place, key in sorted(kept, key=lambda each: -each[0].column):
        _replace(lines, place, key, values[key])
    _insert(lines, first, new, is_flow=first.line == here.line)
    return {file: "".join(each) for file, each in lines.items()}


def _replace(lines: dict[str, list[str]], at: Location, key: str, value: str) -> None:
    line = lines[at.file][at.line - 1]
    head, tail = line[: at.column - 1], line[at.column - 1 :]
    pattern = rf"(\"{key}\"|'{key}'|{key}){_VALUE}"
    found = re.sub(pattern, lambda m: f"{m[1]}{m[2]}{value}", tail, count=1)
    lines[at.file][at.line - 1] = head + found


def _insert(
    lines: dict[str, list[str]],
    first: Location,
    new: Mapping[str, str],
    *,
    is_flow: bool,
) -> None:
    index, column = first.line - 1, first.column - 1
    line = lines[first.file][index]
    if is_flow:
        added = "".join(f"{key}: {value}, " for key, value in new.items())
        lines[first.file][index] = line[:column] + added + line[column:]
    else:
        added = "".join(f"{' ' * column}{k}: {v}\n" for k, v in new.items())
        lines[first.file].insert(index, added)
