"""A robot file and the files that it includes, merged into one tree."""

from __future__ import annotations

from os.path import realpath
from pathlib import Path

from poise.errors import FileProblem
from poise.model.yaml_tree import Location, Node, Scalar, parse
from poise.units import quoted

LARGEST = 1_000_000
"""[bytes] A larger file is an error."""
MOST_FILES = 100
"""More included files than this are an error."""


def read_tree(path: Path, problems: list[FileProblem]) -> Node | None:
    """Return the merged tree of a robot file; every problem is added to `problems`.

    Mappings are merged key by key and lists are joined. A single value that is defined
    twice is a problem. A file that is included twice is read once.
    """
    reader = _Reader(problems)
    reader.read(path, None, ())
    return reader.root


class _Reader:
    def __init__(self, problems: list[FileProblem]) -> None:
        self.root: Node | None = None
        self._problems = problems
        self._done: set[str] = set()

    def read(self, path: Path, asked: Location | None, above: tuple[Path, ...]) -> None:
        """Merge `path` into the root; `above` are the files that led to it."""
        if not self._is_new(path, asked, above):
            return
        root = read_file(path, asked, self._problems)
        if root is None:
            return
        if not isinstance(root.value, dict):
            problem = "a robot file must be a mapping that starts with `robot: name`"
            self._problems.append(root.place.problem(problem))
            return
        _anchor_folders(root.value.get("repository"), path.parent)
        include = root.value.get("include")
        if self.root is None:
            self.root = root
        else:
            root.value.pop("include", None)
            _merge(self.root, root, "", self._problems)
        if include is not None and isinstance(include.value, list):
            for item in include.value:
                self._include(path, item, above)

    def _include(self, path: Path, item: Node, above: tuple[Path, ...]) -> None:
        if isinstance(item.value, Scalar) and "\0" not in item.value.text:
            self.read(path.parent / item.value.text, item.place, (*above, path))
        else:
            self._problems.append(item.place.problem("include: must be file names"))

    def _is_new(
        self, path: Path, asked: Location | None, above: tuple[Path, ...]
    ) -> bool:
        # Unlike Path.resolve, it does not raise for cyclic symbolic links.
        real = realpath(path)
        if asked and real in [realpath(p) for p in above]:
            circle = " -> ".join(p.name for p in (*above, path))
            self._problems.append(
                asked.problem(f"include: the files include each other: {circle}")
            )
        elif asked and len(self._done) == MOST_FILES and real not in self._done:
            text = f"include: more than {MOST_FILES} files"
            self._problems.append(asked.problem(text))
        elif real not in self._done:
            self._done.add(real)
            return True
        return False


def read_file(
    path: Path, asked: Location | None, problems: list[FileProblem]
) -> Node | None:
    """Return the tree of one file, or None; every problem is added to `problems`."""
    text = _read_text(path, asked, problems)
    return None if text is None else parse(text, str(path), problems)


def _anchor_folders(node: Node | None, folder: Path) -> None:
    """Let folders be relative to the file that names them, before files are merged."""
    if node is not None and isinstance(node.value, list):
        for item in node.value:
            if isinstance(item.value, Scalar):
                item.value = Scalar(str(folder / item.value.text), plain=False)


def _read_text(
    path: Path, asked: Location | None, problems: list[FileProblem]
) -> str | None:
    def wrong(text: str) -> None:
        where = asked or Location(str(path), 0, 0)
        named = f"include: {quoted(path.name)} {text}" if asked else text
        problems.append(where.problem(named))

    try:
        if path.is_dir():
            wrong("is a folder, not a robot file")
        elif not path.exists():
            wrong("does not exist")
        elif not path.is_file():
            wrong("is not an ordinary file")
        elif path.stat().st_size > LARGEST:
            wrong(f"is larger than {LARGEST} bytes, the limit for a robot file")
        else:
            return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = error.object[: error.start]
        column = error.start - before.rfind(b"\n")
        place = Location(str(path), before.count(b"\n") + 1, column)
        problems.append(place.problem(f"is not UTF-8 text: {error.reason}"))
    except OSError as error:
        wrong(f"cannot be read: {error.strerror}")
    return None


def _merge(into: Node, other: Node, name: str, problems: list[FileProblem]) -> None:
    if isinstance(into.value, list) and isinstance(other.value, list):
        into.value.extend(other.value)
    elif (
        isinstance(into.value, dict)
        and isinstance(other.value, dict)
        and _is_section(name)
    ):
        for key, node in other.value.items():
            present = into.value.setdefault(key, node)
            if present is not node:
                _merge(present, node, f"{name}.{key}".removeprefix("."), problems)
    else:
        problems.append(
            other.place.problem(f"{name} is defined twice, first at {into.place}")
        )


def _is_section(name: str) -> bool:
    """Whether the mapping is the file itself or one of its sections."""
    return "." not in name
