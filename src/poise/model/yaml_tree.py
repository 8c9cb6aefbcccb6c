"""Reads YAML files into trees of nodes, each with its location in the file.

A scalar stays text until the type of its field gives it a meaning, so that
`address: 10.0` and a computer called `on` stay texts.
"""

from __future__ import annotations

import pathlib
import re
import stat
from collections.abc import Iterable, Iterator, Mapping

import yaml
from msgspec import Struct
from yaml.reader import Reader

from poise.errors import FileProblem
from poise.units import quoted

LARGEST = 1_000_000
"""[bytes] A larger file is an error."""
DEEPEST = 40
"""[levels] Deeper nesting is an error."""
MOST = 100_000
"""[values] More of them in one file, after aliases are expanded, are an error."""
_NO_TEXT = re.compile("[\0\ud800-\udfff]")
_YAML = "tag:yaml.org,2002:"  # what `!!` stands for


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
    """A value in the file: a mapping, a list or a scalar."""

    place: Location  # of its key, or of the value when it has no key
    value: dict[str, Node] | list[Node] | Scalar


def read_file(
    path: pathlib.Path, asked: Location | None, problems: list[FileProblem]
) -> Node | None:
    """Return the tree of one file, or None; every problem is added to `problems`."""
    text = _read_text(path, asked, problems)
    return None if text is None else parse(text, str(path), problems)


def _read_text(
    path: pathlib.Path, asked: Location | None, problems: list[FileProblem]
) -> str | None:
    def wrong(text: str) -> None:
        where = asked or Location(str(path), 0, 0)
        named = f"include: {quoted(path.name)} {text}" if asked else text
        problems.append(where.problem(named))

    try:
        found = path.stat()  # from Python 3.14 on, `exists` does not say what is wrong
        if stat.S_ISDIR(found.st_mode):
            wrong("is a folder, not a file")
        elif not stat.S_ISREG(found.st_mode):
            wrong("is not an ordinary file")
        elif found.st_size > LARGEST:
            wrong(f"is larger than {LARGEST} bytes, the limit for such a file")
        else:
            return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = error.object[: error.start]
        column = error.start - before.rfind(b"\n")
        place = Location(str(path), before.count(b"\n") + 1, column)
        problems.append(place.problem(f"is not UTF-8 text: {error.reason}"))
    except (FileNotFoundError, NotADirectoryError):
        wrong("does not exist")
    except OSError as error:
        wrong(f"cannot be read: {error.strerror}")
    return None


class _Bad(Exception):
    """The text cannot be made into a tree."""

    def __init__(self, problem: FileProblem) -> None:
        super().__init__(problem)
        self.problem = problem


def parse(text: str, file: str, problems: list[FileProblem]) -> Node | None:
    """Return the tree of a YAML text; None: `problems` say why it has none."""
    if special := Reader.NON_PRINTABLE.search(text):
        before = text[: special.start()]
        column = special.start() - before.rfind("\n")
        place = Location(file, before.count("\n") + 1, column)
        problems.append(place.problem("not YAML: special characters are not allowed"))
        return None
    builder = _Builder(text, file, problems)
    try:
        return builder.document()
    except _Bad as error:
        problems.append(error.problem)
    except yaml.MarkedYAMLError as error:
        problems.append(_syntax_problem(error, file))
    except (ValueError, OverflowError, yaml.YAMLError) as error:
        # PyYAML raises these for some escapes, such as "\UFFFFFFFF"
        problems.append(builder.last.problem(f"not YAML: {error}"))
    return None


_Parser: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Of these only the parser is used: it makes events of a text, in C where it can."""


class _Builder:
    """Makes a tree of the events of a YAML text."""

    def __init__(self, text: str, file: str, problems: list[FileProblem]) -> None:
        self._events = _Parser(text)
        self._file = file
        self._problems = problems
        self._anchors: dict[str | None, Node | None] = {}  # None: not complete yet
        self._count = 0
        self.last = Location(file, 1, 1)

    def document(self) -> Node:
        """Return the tree of the only document."""
        self._next()
        if isinstance(self._next(), yaml.StreamEndEvent):
            raise _Bad(Location(self._file, 1, 1).problem("the file is empty"))
        root = self._node(self._next(), None, 0)
        self._next()
        if not isinstance(self._next(), yaml.StreamEndEvent):
            raise _Bad(self.last.problem("not YAML: expected a single document"))
        return root

    def _next(self) -> yaml.Event:
        event: yaml.Event = self._events.get_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        assert mark is not None  # noqa: S101 - it is of a text
        self.last = Location(self._file, mark.line + 1, mark.column + 1)
        return event

    def _node(self, event: yaml.Event, key: Location | None, depth: int) -> Node:
        place = key or self.last
        self._check_size(place, depth)
        if isinstance(event, yaml.AliasEvent):
            return Node(place, self._copy(self._anchored(event.anchor), depth).value)
        assert isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent)  # noqa: S101
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        if event.tag is not None:
            written = quoted(event.tag.replace(_YAML, "!!"))
            text = f"YAML tags are not supported: {written}; a text goes in quotes"
            self._wrong(place, text)
        node = Node(place, self._value(event, place, depth))
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _value(
        self, event: yaml.Event, place: Location, depth: int
    ) -> dict[str, Node] | list[Node] | Scalar:
        if isinstance(event, yaml.MappingStartEvent):
            return dict(self._entries(depth))
        if isinstance(event, yaml.ScalarEvent):
            if _NO_TEXT.search(event.value):
                text = f"{quoted(event.value)} contains a character that is not allowed"
                self._wrong(place, text)
            return Scalar(event.value, plain=not event.style)
        return list(self._items(depth))

    def _items(self, depth: int) -> Iterator[Node]:
        while not isinstance(event := self._next(), yaml.SequenceEndEvent):
            yield self._node(event, None, depth + 1)

    def _entries(self, depth: int) -> Iterator[tuple[str, Node]]:
        first: dict[str, Location] = {}
        while not isinstance(event := self._next(), yaml.MappingEndEvent):
            place = self.last
            key = self._node(event, None, depth + 1).value
            self._count -= 1  # only values count
            value = self._node(self._next(), place, depth + 1)
            if not isinstance(key, Scalar):
                self._wrong(place, "a key must be a word, not a list or mapping")
            elif key == Scalar("<<", plain=True):
                text = "merge keys (<<) are not supported: write the keys themselves"
                self._wrong(place, text)
            elif key.text in first:
                once = f"is defined twice, first at {first[key.text]}"
                self._wrong(place, f"the key {quoted(key.text)} {once}")
            else:
                first[key.text] = place
                yield key.text, value

    def _anchored(self, name: str | None) -> Node:
        node = self._anchors.get(name)
        if node is None:
            what = "contains itself" if name in self._anchors else "has no anchor"
            raise _Bad(self.last.problem(f"not YAML: the alias *{name} {what}"))
        return node

    def _copy(self, node: Node, depth: int) -> Node:
        """Return a tree of its own, for what an alias stands for may be changed."""
        self._check_size(node.place, depth)
        if isinstance(node.value, dict):
            entries = node.value.items()
            value = {key: self._copy(node, depth + 1) for key, node in entries}
            return Node(node.place, value)
        if isinstance(node.value, list):
            return Node(node.place, [self._copy(e, depth + 1) for e in node.value])
        return Node(node.place, node.value)

    def _check_size(self, place: Location, depth: int) -> None:
        self._count += 1
        if depth >= DEEPEST:
            raise _Bad(place.problem(f"nested more than {DEEPEST} levels deep"))
        if self._count > MOST:
            raise _Bad(place.problem(f"more than {MOST} values, with those of aliases"))

    def _wrong(self, place: Location, text: str) -> None:
        self._problems.append(place.problem(text))


def _syntax_problem(error: yaml.MarkedYAMLError, file: str) -> FileProblem:
    mark = error.problem_mark or error.context_mark
    line, column = (mark.line, mark.column) if mark else (0, 0)
    parts = [error.context, error.problem]
    text = "not YAML: " + ", ".join(p for p in parts if p)
    if "mapping values" in text:
        text += " (is it indented too far, or is a `{` or quote before it stray?)"
    if "cannot start any token" in text:
        text += " (is it a tab, or a `@`, `%` or '`' without quotes around the text?)"
    return Location(file, line + 1, column + 1).problem(text)


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
            (self._places[path] for path in below), key=lambda p: (p.line, p.column)
        )

    def broken(self, section: str, problems: Iterable[FileProblem]) -> set[str]:
        """Return the entries of a section in which there are problems."""
        places = {Location(each.file, each.line, each.column) for each in problems}
        return {
            str(path[1])
            for path, place in self._places.items()
            if path[:1] == (section,) and len(path) > 1 and place in places
        }

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
    new = {k: v for k, v in values.items() if not positions.has((*path, k))}
    # from right to left, so that the remaining locations stay valid
    kept = [(positions.at((*path, key)), key) for key in values if key not in new]
    for place, key in sorted(kept, key=lambda edit: -edit[0].column):
        _replace(lines, place, key, values[key])
    _insert(lines, first, new)
    return {file: "".join(parts) for file, parts in lines.items()}


def _replace(lines: dict[str, list[str]], at: Location, key: str, value: str) -> None:
    line = lines[at.file][at.line - 1]
    head, tail = line[: at.column - 1], line[at.column - 1 :]
    pattern = rf"(\"{key}\"|'{key}'|{key}){_VALUE}"
    changed = re.sub(pattern, lambda m: f"{m[1]}{m[2]}{value}", tail, count=1)
    lines[at.file][at.line - 1] = head + changed


def _insert(
    lines: dict[str, list[str]], first: Location, new: Mapping[str, str]
) -> None:
    index, column = first.line - 1, first.column - 1
    line = lines[first.file][index]
    before = "".join(lines[first.file][:index]) + line[:column]
    if before.rstrip().endswith("{"):
        added = "".join(f"{key}: {value}, " for key, value in new.items())
        lines[first.file][index] = line[:column] + added + line[column:]
    else:
        end = "\r\n" if line.endswith("\r\n") else "\n"
        added = "".join(f"{' ' * column}{k}: {v}{end}" for k, v in new.items())
        lines[first.file].insert(index, added)
