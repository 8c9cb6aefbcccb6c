"""From the command line of a ROS 2 process to the keys that start it again; pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import yaml
from msgspec import Struct

from poise.session.ros2_import.graph_records import NodeProcess, Start

ReadFile = Callable[[str], str]
"""Returns a file's text; raises OSError."""

_PYTHON = re.compile(r"(python|pypy)[\d.]*")
_PACKAGE = re.compile(r"(?!python)[a-z][a-z0-9_]*")
_TEMPORARY = "/tmp/"  # noqa: S108, where launch writes parameters
_NAMED = {"__node": "name", "__name": "name", "__ns": "namespace"}


class RosArguments(Struct, frozen=True, kw_only=True):
    """A command line, split: what is ROS 2's is no part of `program` and `others`."""

    program: tuple[str, ...]
    others: tuple[str, ...] = ()
    name: str = ""
    namespace: str = ""
    remap: Mapping[str, str] = {}
    params: Mapping[str, Any] = {}
    files: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    """What is for ROS 2 and has no key: log levels, enclaves."""


def split(arguments: Sequence[str]) -> RosArguments:
    """Return the command line of a process, split."""
    mine, theirs = _sections(arguments)
    remap: dict[str, str] = {}
    special: dict[str, str] = {}
    params: dict[str, Any] = {}
    files, kept = [], []
    words = iter(theirs)
    for word in words:
        if word in {"-r", "--remap"}:
            before, _, after = next(words, "").partition(":=")
            if before in _NAMED:
                special[_NAMED[before]] = after
            else:
                remap[before] = after
        elif word in {"-p", "--param"}:
            before, _, after = next(words, "").partition(":=")
            params[before] = yaml.safe_load(after)
        elif word == "--params-file":
            files.append(next(words, ""))
        else:
            kept.append(word)
    program = _program_length(mine)
    return RosArguments(
        program=tuple(mine[:program]),
        others=tuple(mine[program:]),
        remap=remap,
        params=params,
        files=tuple(files),
        kept=tuple(kept),
        **special,
    )


def _sections(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the program's own arguments, and those between `--ros-args` and `--`."""
    sections: tuple[list[str], list[str]] = ([], [])
    is_ros = False
    for argument in arguments:
        if argument == "--ros-args":
            is_ros = True
        elif argument == "--" and is_ros:
            is_ros = False
        else:
            sections[is_ros].append(argument)
    return sections


def _program_length(words: Sequence[str]) -> int:
    """Return how many words name the program: an interpreter's flags and file, too."""
    if not words or not _PYTHON.fullmatch(PurePosixPath(words[0]).name):
        return 1
    length = 1
    while length < len(words) and words[length].startswith("-"):
        flag = words[length]
        if flag in {"-m", "-c"}:
            return length + 2
        length += 2 if flag in {"-X", "-W"} else 1
    return length + 1


def parameters_in(text: str, node: str) -> dict[str, Any]:
    """Return what a parameter file says for a node, by its full name."""
    found: dict[str, Any] = {}
    for pattern, section in _sections_of(yaml.safe_load(text) or {}, ""):
        regex = re.escape(pattern).replace(r"/\*\*", "(/.+)?").replace(r"\*", "[^/]+")
        if re.fullmatch(regex, node):
            found.update(section)
    return found


def _sections_of(
    tree: Mapping[str, Any], above: str
) -> list[tuple[str, Mapping[str, Any]]]:
    found: list[tuple[str, Mapping[str, Any]]] = []
    for key, value in tree.items():
        if key == "ros__parameters":
            found.append((above, value or {}))
        elif isinstance(value, Mapping):
            found += _sections_of(value, f"{above}/{key.strip('/')}")
    return found


class WhereImported(Struct, frozen=True, kw_only=True):
    """Where a robot file will be started from.

    `folder` is the robot file's, `environment` what matters to ROS 2 there, and
    `python` the interpreter that Poise runs in. `read` returns a file's text.
    """

    folder: str
    environment: Mapping[str, str]
    python: str
    read: ReadFile


def start_of(process: NodeProcess, here: WhereImported) -> Start:
    """Return the keys of a component that start a process again."""
    if not process.arguments:
        return Start(remarks=("its command line cannot be read",))
    found = split(process.arguments)
    differs = {
        name: value
        for name, value in process.environment.items()
        if here.environment.get(name) != value
    }
    ros2, remarks = _program(process, found, here), list[str]()
    params, files = _parameters(process, found, here, remarks)
    kept = ["--ros-args", *found.kept, "--"] if found.kept else []
    optional = {
        "arguments": [*ros2.pop("arguments", ()), *found.others, *kept],
        "name": found.name,
        "namespace": found.namespace,
        "remap": dict(found.remap),
        "params": params | dict(found.params),
        "params_files": files,
    }
    keys: dict[str, Any] = {"ros2": ros2 | {k: v for k, v in optional.items() if v}}
    if differs:
        keys["environment"] = differs
    return Start(keys=keys, remarks=tuple(remarks))


def _program(
    process: NodeProcess, found: RosArguments, here: WhereImported
) -> dict[str, Any]:
    """Return package and executable, or else what starts the same program."""
    path = PurePosixPath(found.program[-1])
    is_plain = len(found.program) <= 2 and not path.name.startswith("-")  # noqa: PLR2004
    is_package = path.parts[-3:-2] == ("lib",) and _PACKAGE.fullmatch(path.parts[-2])
    if is_plain and is_package:
        return {"package": path.parts[-2], "executable": path.name}
    if PurePosixPath(process.folder) != PurePosixPath(here.folder):
        words = ["-C", process.folder, *found.program]
        return {"executable": "env", "arguments": words}
    is_own_python = found.program[0] == here.python
    if is_plain and is_own_python and path.suffix == ".py":
        name = _relative(str(path), process.folder, here.folder)
        return {"executable": name if "/" in name else f"./{name}"}
    program = "python" if is_own_python else found.program[0]
    return {"executable": program, "arguments": list(found.program[1:])}


def _relative(file: str, folder: str, to: str) -> str:
    """Return a path of a process that works in `folder`, from another folder."""
    path = PurePosixPath(folder, file)
    return str(path.relative_to(to) if path.is_relative_to(to) else path)


def _parameters(
    process: NodeProcess, found: RosArguments, here: WhereImported, remarks: list[str]
) -> tuple[dict[str, Any], list[str]]:
    """Return parameters of files that may vanish, and the other files."""
    params: dict[str, Any] = {}
    files = []
    for file in found.files:
        if not file.startswith(_TEMPORARY):
            files.append(_relative(file, process.folder, here.folder))
        elif len(process.nodes) > 1:
            files.append(file)
            remarks.append(f"{file} may be a temporary file: keep a copy")
        else:
            try:
                params.update(parameters_in(here.read(file), process.nodes[0]))
            except (OSError, yaml.YAMLError) as error:
                remarks.append(f"parameters are missing: {file}: {error}")
    return params, files


def component_name(process: NodeProcess) -> str:
    """Return a name for the component that a process becomes."""
    if len(process.nodes) == 1:
        return name_of(process.nodes[0])
    program = split(process.arguments).program if process.arguments else ()
    last = PurePosixPath(program[-1]).name.removesuffix(".py") if program else ""
    return name_of(last.rpartition(".")[2] or process.nodes[0])


def name_of(ros_name: str) -> str:
    """Return a ROS 2 name as one of the robot file: ``/a/b`` is ``a_b``."""
    name = re.sub(r"\W", "_", ros_name.strip("/"), flags=re.ASCII)[:63]
    return name if name[:1].isalpha() else f"n{name}"[:63]
