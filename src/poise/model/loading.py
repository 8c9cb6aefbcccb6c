"""Reads a robot file, and those that it includes, or reports every problem at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from os.path import realpath
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.decoding import convert
from poise.errors import FileProblem, RobotError, UsageError, why_too_old
from poise.model.check.allowed_computers import (
    check_allowed_computers,
    check_checkpoints,
    check_demands,
    check_together_apart,
    check_voting,
)
from poise.model.check.connectors import (
    check_chains,
    check_connectors,
    check_ports,
    declared_ports,
)
from poise.model.check.names import check_addresses, check_names
from poise.model.check.ros2_components import check_ros2, with_ros2
from poise.model.check.task_checks import (
    check_ends,
    check_policies,
    check_tasks,
    check_workload,
)
from poise.model.file_keys import record_of
from poise.model.includes import (
    Given,
    Include,
    add_prefix,
    arguments_of,
    as_given,
    fill,
    fill_include,
    given_in,
    unknown_arguments,
)
from poise.model.repository import Repository, with_repository
from poise.model.robot import Robot
from poise.model.yaml_tree import Finding, Location, Node, Positions, Scalar, read_file
from poise.model.yaml_validation import validate
from poise.units import quoted


class Source(Struct, frozen=True):
    """A robot, the locations of its parts in its files, and what the repository has."""

    robot: Robot
    positions: Positions
    repository: Repository = Repository()


def load(path: str | Path, arguments: Mapping[str, object] | None = None) -> Robot:
    """Return the robot that the file at `path` describes.

    Raises
    ------
    RobotError
        It contains every problem of the file and its included files.
    UsageError
        The file has no argument of such a name.
    """
    return load_source(path, arguments).robot


def load_source(
    path: str | Path, arguments: Mapping[str, object] | None = None
) -> Source:
    """Return the robot and the positions of its parts; raises as `load` does."""
    problems: list[FileProblem] = []
    path = Path(path)
    if "\0" in str(path):
        raise RobotError(f"{quoted(path)} is not a file name")
    root = read_tree(path, problems, as_given(arguments or {}))
    if root is None:
        raise RobotError(problems=problems)
    if too_old := _too_old(root):
        raise RobotError(problems=[too_old])
    # Names of a file that could not be included would seem unknown.
    is_whole = not problems
    found: list[FileProblem] = []
    values = validate(root, record_of(Robot), found)
    # and a key of the robot that is missing may be there
    problems += [p for p in found if is_whole or not p.message.startswith("the key '")]
    if values is None or not is_whole:
        raise RobotError(problems=sorted(problems))
    values["folder"] = folder = str(path.resolve().parent)
    try:
        folder.encode()
    except UnicodeEncodeError:  # all processes of the robot get it, as text
        raise RobotError(f"{quoted(path)}: its folder's name is not UTF-8") from None
    own = convert(values, Robot)
    robot, repository = with_repository(own, root, problems)
    positions = Positions(root)
    before = (*check_addresses(robot), *check_ros2(robot))  # `with_ros2` needs both
    wrong = [positions.problem(finding) for finding in before]
    robot = robot if wrong else with_ros2(robot)
    problems += wrong
    broken = positions.broken("policies", problems)
    findings = check(robot, repository, broken)
    problems += [positions.problem(finding) for finding in findings]
    if problems:
        raise RobotError(problems=sorted(problems))
    folders = tuple(str(Path(folder).resolve()) for folder in robot.repository)
    robot = msgspec.structs.replace(robot, repository=folders)
    return Source(robot, positions, repository)


def _too_old(root: Node) -> FileProblem | None:
    """Return what is wrong when a file is for a newer Poise: all else follows."""
    keys = root.value if isinstance(root.value, dict) else {}
    node = keys.get("poise")
    if node is None or not isinstance(node.value, Scalar):
        return None
    try:
        why = why_too_old(node.value.text)
    except ValueError as error:
        return node.place.problem(f"poise: {error}")
    return node.place.problem(f"poise: {why}") if why else None


def check(
    robot: Robot, repository: Repository, broken: Collection[str] = ()
) -> Iterator[Finding]:
    """Yield every problem that shows without code; `broken` policies lack a value."""
    yield from check_names(robot)
    yield from check_voting(robot)
    yield from check_allowed_computers(robot)
    yield from check_checkpoints(robot)
    yield from check_demands(robot)
    yield from check_together_apart(robot)
    yield from check_connectors(robot)
    yield from check_chains(robot)
    yield from check_ports(robot, declared_ports(robot))
    yield from check_workload(robot)
    yield from check_policies(robot, broken)
    yield from check_tasks(robot, repository)
    yield from check_ends(robot, declared_ports(robot))


_INCLUDE = msgspec.inspect.type_info(str | Include)
_INCLUDES = msgspec.inspect.type_info(tuple[str | Include, ...])
MOST_FILES = 100
"""More included files than this are an error."""


def read_tree(path: Path, problems: list[FileProblem], given: Given) -> Node | None:
    """Return the merged tree of a robot file; every problem is added to `problems`.

    A file that is included twice is read once, unless it is included with a prefix or
    arguments. UsageError: the file has no argument of a name in `given`.
    """
    reader = _Reader(problems, [], given, {})
    reader.read(path, None, ())
    if reader.root is None:
        return None
    is_whole = not problems  # else an argument may be in what could not be read
    if is_whole:
        for text in unknown_arguments(reader.root, given).values():
            raise UsageError(f"{path}: {text}")
    fill(reader.root, given, problems if is_whole else [], is_top=True)
    return reader.root


class _Reader:
    def __init__(
        self, problems: list[FileProblem], reads: list[str], given: Given, outer: Given
    ) -> None:
        self.root: Node | None = None
        self._problems = problems
        self._reads = reads  # all files that were read, also by other readers
        self._given, self._outer = given, outer
        self._done: set[str] = set()

    def read(self, path: Path, asked: Location | None, above: tuple[Path, ...]) -> None:
        """Merge `path` into the root; `above` are the files that led to it."""
        if "\0" in str(path) or not self._is_new(path, asked, above):
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
                self._include(item, (*above, path))
            include.value = []  # none is to be validated again
        elif include is not None and asked:  # else it is validated with the rest
            validate(include, _INCLUDES, self._problems, name="include")

    def _include(self, item: Node, above: tuple[Path, ...]) -> None:
        """Merge the file that an item names."""
        assert self.root is not None  # noqa: S101 - it includes
        own = arguments_of(self.root, self._given, [], is_top=False)
        values = {**self._outer, **own}
        known = len(self._problems)
        fill_include(item, values, self._problems)
        if len(self._problems) > known:
            return
        entry = validate(item, _INCLUDE, self._problems, name="include")
        if isinstance(entry, dict):
            self._include_as(item, convert(entry, Include), values, above)
        elif entry is not None:
            self.read(above[-1].parent / entry, item.place, above)

    def _include_as(
        self, item: Node, entry: Include, values: Given, above: tuple[Path, ...]
    ) -> None:
        """Merge a file with other names, and with values for its arguments."""
        given = given_in(item)
        reader = _Reader(self._problems, self._reads, given, values)
        reader.read(above[-1].parent / entry.file, item.place, above)
        root = reader.root
        if root is None:
            return
        assert isinstance(root.value, dict)  # noqa: S101 - it was read
        root.value.pop("include", None)
        for text in unknown_arguments(root, given).values():
            self._problems.append(item.place.problem(f"include: {text}"))
        fill(root, given, self._problems, is_top=False)
        root.value.pop("arguments", None)
        if entry.prefix:
            add_prefix(root, entry.prefix, self._problems)
        assert self.root is not None  # noqa: S101 - it includes
        _merge(self.root, root, "", self._problems)

    def _is_new(
        self, path: Path, asked: Location | None, above: tuple[Path, ...]
    ) -> bool:
        # Unlike Path.resolve, it does not raise for cyclic symbolic links.
        try:
            real = realpath(path)
        except FileNotFoundError:  # the working directory was removed
            real = str(path)
        if asked and real in [realpath(p) for p in above]:
            circle = " -> ".join(p.name for p in (*above, path))
            self._problems.append(
                asked.problem(f"include: the files include each other: {circle}")
            )
        elif asked and len(self._reads) >= MOST_FILES and real not in self._done:
            text = f"include: more than {MOST_FILES} files"
            self._problems.append(asked.problem(text))
        elif real not in self._done:
            self._done.add(real)
            self._reads.append(real)
            return True
        return False


def _anchor_folders(node: Node | None, folder: Path) -> None:
    """Let folders be relative to the file that names them, before files are merged."""
    if node is not None and isinstance(node.value, list):
        for item in node.value:
            if isinstance(item.value, Scalar):
                item.value = Scalar(str(folder / item.value.text), plain=False)


def _merge(into: Node, other: Node, name: str, problems: list[FileProblem]) -> None:
    if isinstance(into.value, list) and isinstance(other.value, list):
        into.value.extend(other.value)
    elif (
        isinstance(into.value, dict)
        and isinstance(other.value, dict)
        and "." not in name  # the file itself, or one of its sections
    ):
        for key, node in other.value.items():
            present = into.value.setdefault(key, node)
            if present is not node:
                _merge(present, node, f"{name}.{key}".removeprefix("."), problems)
    else:
        problems.append(
            other.place.problem(f"{name} is defined twice, first at {into.place}")
        )
