"""The processes of ROS 2 nodes: what they use, and how each is started again."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from pathlib import Path, PurePosixPath
from typing import Any

import yaml
from msgspec import Struct

from poise.kernel_counters import (
    ComputerCpu,
    ComputerMemory,
    process_cpu,
    proportional_memory,
    resident_memory,
)
from poise.model.ros2_node import flat
from poise.session.ros2_import.graph_records import Hardware, NodeProcess, Start

PREFIXES = ("ROS_", "RMW_", "FASTRTPS_", "FASTDDS_", "CYCLONEDDS_", "AMENT_")
"""Variables that change what ROS 2 does begin so."""
_ALSO = {"PYTHONPATH"}
_HARMLESS = {"ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION"}
_ANYBODYS = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")
_NO_DEVICES = ("/dev/pts/", "/dev/tty", "/dev/ptmx", "/dev/fuse")
"""Many have these open, or their like: /dev/tty1. /dev/ttyUSB0 is a device."""
_SERIAL = ("/dev/ttyUSB", "/dev/ttyACM", "/dev/ttyAMA", "/dev/ttyS", "/dev/ttyTHS")


def relevant(environment: Mapping[str, str]) -> dict[str, str]:
    """Return what of an environment matters to ROS 2 and to Python."""
    return {
        name: value
        for name, value in environment.items()
        if (name.startswith(PREFIXES) or name in _ALSO) and name not in _HARMLESS
    }


def find_pid(low: int) -> int | None:
    """Return the process that has ROS 2 loaded and this id; None: unclear.

    `low`: the last 16 bits of its id, in its own namespace of processes.
    """
    found = [
        int(folder.name)
        for folder in Path("/proc").iterdir()
        if folder.name.isdigit() and low in _low_ids(folder) and _has_ros(folder)
    ]
    return found[0] if len(found) == 1 else None


def _low_ids(folder: Path) -> set[int]:
    with contextlib.suppress(OSError):
        for line in (folder / "status").read_text().splitlines():
            if line.startswith("NSpid:"):
                return {int(line.split()[-1]) & 0xFFFF}
    return set()


def _has_ros(folder: Path) -> bool:
    try:
        return "librmw" in (folder / "maps").read_text()
    except OSError:  # another user's: its id has to do
        return True


class ProcessUsage:
    """What some processes use from now on, each with its other child processes."""

    def __init__(self) -> None:
        self.pids: set[int] = set()
        self._began = time.monotonic()
        self._computer = ComputerCpu()
        self._all_cpu = self._computer.read() or 0.0
        self._first: dict[int, tuple[float, float]] = {}

    def add(self, pid: int) -> None:
        """Measure one more from now on."""
        self.pids.add(pid)
        self._first.setdefault(pid, (time.monotonic(), self._used(pid)))

    def cpu(self, pid: int) -> float:
        """Return the mean use since it was added [cores]."""
        began, before = self._first[pid]
        elapsed = time.monotonic() - began
        return max(0.0, self._used(pid) - before) / elapsed if elapsed > 0 else 0.0

    def memory(self, pid: int) -> float:
        """Return its share of the memory that it holds [bytes]."""
        held = (proportional_memory(p) or resident_memory(p) for p in self._family(pid))
        return float(sum(held))

    def _used(self, pid: int) -> float:
        return sum(map(process_cpu, self._family(pid)))

    def _family(self, pid: int) -> list[int]:
        found = [pid]
        for parent in found:
            with contextlib.suppress(OSError, ValueError):
                text = Path(f"/proc/{parent}/task/{parent}/children").read_text()
                found += [int(word) for word in text.split()]
        return [each for each in found if each == pid or each not in self.pids]

    def hardware(self, processes: Iterable[NodeProcess], own_cpu: float) -> Hardware:
        """Return this computer, and what all but `processes` and this one take."""
        processes = tuple(processes)
        busy = (self._computer.read() or 0.0) - self._all_cpu
        busy /= time.monotonic() - self._began
        room = ComputerMemory().read()
        limit, free = (room.limit, room.free) if room else (0.0, 0.0)
        held = sum(each.memory for each in processes) + self.memory(os.getpid())
        return Hardware(
            name=os.uname().nodename,
            cores=float(len(os.sched_getaffinity(0))),
            memory=limit,
            other_cpu=max(0.0, busy - own_cpu - sum(each.cpu for each in processes)),
            other_memory=max(0.0, limit - free - held),
        )


def describe(pid: int, nodes: tuple[str, ...], usage: ProcessUsage) -> NodeProcess:
    """Return what `/proc` says of a process."""
    folder = Path(f"/proc/{pid}")
    variables = (word.partition("=") for word in _words(folder / "environ"))
    environment = {name: value for name, _, value in variables}
    arguments = _words(folder / "cmdline")
    if arguments and "/" not in arguments[0]:
        path = shutil.which(arguments[0], path=environment.get("PATH"))
        arguments = (path or arguments[0], *arguments[1:])
    with contextlib.suppress(OSError):
        folder = (folder / "cwd").readlink()
    return NodeProcess(
        pid=pid,
        nodes=nodes,
        arguments=arguments,
        folder=str(folder),
        environment=relevant(environment),
        cpu=usage.cpu(pid),
        memory=usage.memory(pid),
        devices=devices_of(pid),
    )


def _words(file: Path) -> tuple[str, ...]:
    try:
        text = file.read_text(errors="replace")
    except OSError:
        return ()
    return tuple(text.removesuffix("\0").split("\0")) if text else ()


def devices_of(pid: int) -> tuple[str, ...]:
    """Return the device nodes that a process has open; drivers must stay with them."""
    found: set[str] = set()
    for entry in Path(f"/proc/{pid}/fd").glob("*"):
        with contextlib.suppress(OSError):
            path = str(entry.readlink())
            mode = entry.stat().st_mode
            if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
                found.add(path)
    return tuple(sorted(filter(_is_device, found)))


def _is_device(path: str) -> bool:
    is_known = path.startswith("/dev/") and path not in _ANYBODYS
    return is_known and (path.startswith(_SERIAL) or not path.startswith(_NO_DEVICES))


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
            params[before] = _value_of(after)
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


_TRUE = re.compile("y|Y|yes|Yes|YES|true|True|TRUE|on|On|ON")
_FALSE = re.compile("n|N|no|No|NO|false|False|FALSE|off|Off|OFF")
_OCTAL = re.compile(r"[+-]?0[0-7]+")
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[1-9][0-9]*|0)")
_FLOAT = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?\.?(inf|nan)", re.IGNORECASE)
_LARGEST = 2**63


def _value_of(text: str) -> Any:  # noqa: ANN401, any value of YAML
    """Return what is behind ``-p name:=``."""
    try:
        return _plain(yaml.compose(text, yaml.SafeLoader))
    except yaml.YAMLError:
        return text


def _plain(node: yaml.Node | None) -> Any:  # noqa: ANN401, any value of YAML
    """Return YAML as ROS 2 reads it: 1e-3 is a number there, a date or 1:30 is text."""
    if node is None:
        return ""
    if isinstance(node, yaml.MappingNode):
        return {str(key.value): _plain(value) for key, value in node.value}
    if isinstance(node, yaml.SequenceNode):
        return [_plain(each) for each in node.value]
    is_quoted = isinstance(node, yaml.ScalarNode) and node.style in {"'", '"'}
    return node.value if is_quoted else _scalar(node.value)


def _scalar(text: str) -> bool | int | float | str:
    if _TRUE.fullmatch(text) or _FALSE.fullmatch(text):
        return bool(_TRUE.fullmatch(text))
    is_octal = _OCTAL.fullmatch(text)
    if is_octal or _INTEGER.fullmatch(text):
        value = int(text, 8 if is_octal else 0)
        if -_LARGEST <= value < _LARGEST:
            return value
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    is_number = _FLOAT.fullmatch(text) and isfinite(float(text))
    return float(text) if is_number else text


def parameters_in(text: str, node: str) -> dict[str, Any]:
    """Return what a parameter file says for a node, by its full name.

    Later sections win; a wildcard fits as in ROS 2: ``*`` one name, ``**`` any number.
    Parameters have their full names, as in ``a.b``. ValueError, YAMLError: it has none.
    """
    tree = _plain(yaml.compose(text, yaml.SafeLoader)) or {}
    if not isinstance(tree, Mapping):
        raise ValueError("no node is named in it")  # noqa: TRY004, what a file says
    found: dict[str, Any] = {}
    for pattern, section in _sections_of(tree, ""):
        regex = re.escape(pattern).replace(r"/\*\*", "(/.+)?").replace(r"\*", "[^/]+")
        if re.fullmatch(regex, node):
            found.update(flat(section))
    return found


def _sections_of(
    tree: Mapping[str, Any], above: str
) -> list[tuple[str, Mapping[str, Any]]]:
    found: list[tuple[str, Mapping[str, Any]]] = []
    for key, value in tree.items():
        if not isinstance(value, Mapping):
            continue
        if key == "ros__parameters":
            found.append((above, value))
        else:
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
    params |= found.params
    kept = [*found.kept, *_unwritable(params)]
    kept = ["--ros-args", *kept, "--"] if kept else []
    optional = {
        "arguments": [*ros2.pop("arguments", ()), *found.others, *kept],
        "name": found.name,
        "namespace": found.namespace,
        "remap": dict(found.remap),
        "params": params,
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
    is_own_python = _is_same(found.program[0], here.python)
    if is_plain and is_own_python and path.suffix == ".py":
        name = _relative(str(path), process.folder, here.folder)
        return {"executable": name if "/" in name else f"./{name}"}
    program = "python" if is_own_python else found.program[0]
    return {"executable": program, "arguments": list(found.program[1:])}


def _is_same(one: str, other: str) -> bool:
    """Return whether two paths name one program of one folder: `python`, `python3`."""
    paths = PurePosixPath(one), PurePosixPath(other)
    return one == other or (
        paths[0].parent == paths[1].parent
        and all(_PYTHON.fullmatch(path.name) for path in paths)
    )


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
            for name in _names_in(process, file, here):  # it comes later, so it wins
                params.pop(name, None)
        elif len(process.nodes) > 1:
            files.append(file)
            remarks.append(f"{file} may be a temporary file: keep a copy")
        else:
            try:
                params.update(parameters_in(here.read(file), process.nodes[0]))
            except (OSError, ValueError, yaml.YAMLError) as error:
                why = " ".join(str(error).split())  # a comment is one line
                remarks.append(f"parameters are missing: {file}: {why}")
    return params, files


def _unwritable(params: dict[str, Any]) -> list[str]:
    """Return as arguments the parameters that no robot file holds; drop them there."""
    names = [
        name
        for name, value in params.items()
        if value == []
        or not all(
            isfinite(each)
            for each in (value if isinstance(value, list) else [value])
            if isinstance(each, float)
        )
    ]
    return [word for n in names for word in ("-p", f"{n}:={params.pop(n)}")]


def _names_in(process: NodeProcess, file: str, here: WhereImported) -> Iterable[str]:
    """Return the parameters that a file sets for a process's node, if it has one."""
    if len(process.nodes) == 1:
        with contextlib.suppress(OSError, ValueError, yaml.YAMLError):
            text = here.read(str(PurePosixPath(process.folder, file)))
            return parameters_in(text, process.nodes[0])
    return ()


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
