"""A ROS 2 node that is a component, as the robot file describes it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from msgspec import Struct

from poise.model.file_keys import Reference, note, says

_WORD = r"[A-Za-z_][A-Za-z0-9_]*"
_OWN = r"\{(node|ns|namespace)\}"
_PART = rf"([A-Za-z_]|{_OWN})([A-Za-z0-9_]|{_OWN})*"
_NAME = rf"(~(/{_PART})*|/?{_PART}(/{_PART})*)"
RosName = Annotated[
    str,
    note(
        pattern=rf"^{_NAME}$",
        expected="a name of ROS 2: letters, digits, '_' and '/', as /front/scan",
        examples=("/scan", "cmd_vel"),
    ),
]
_Namespace = Annotated[
    str,
    note(
        pattern=rf"^(/|/?{_WORD}(/{_WORD})*)$",
        expected="a namespace of ROS 2: letters, digits, '_' and '/', as /front",
        examples=("/front",),
    ),
]
_RemappedName = Annotated[
    str,
    note(
        pattern=rf"^((rostopic|rosservice)://|{_WORD}:)?{_NAME}$",
        expected="a name of ROS 2, as scan or /front/scan",
        examples=("scan",),
    ),
]


START = "how it starts"
"""Poise's own parameter of a `node`: no parameter of ROS 2 is called so."""


class Ros2Node(Struct, frozen=True, kw_only=True):
    """A ROS 2 node that is a component: an executable of any language, or a class."""

    executable: Annotated[
        str,
        says(
            "A program: in lib/<package> of a prefix in AMENT_PREFIX_PATH, on the "
            "PATH, or a path with '/', relative to the robot file.",
            is_nullable=True,
            min_length=1,
        ),
    ] = ""
    package: Annotated[
        str, says("The ROS 2 package of the executable.", is_nullable=True)
    ] = ""
    node: Annotated[
        Reference,
        says(
            "Instead: package.module:Class of an rclpy node, or a function that makes "
            "one; nodes of one container share a process.",
            is_nullable=True,
        ),
    ] = ""
    name: Annotated[
        str,
        note(pattern=rf"^({_WORD})?$", expected="letters, digits and '_'"),
        says("The node's name. Default: as its code says.", is_nullable=True),
    ] = ""
    namespace: Annotated[
        _Namespace, says("The node's namespace: /front.", is_nullable=True)
    ] = ""
    remap: Annotated[
        Mapping[_RemappedName, RosName],
        says("Names of its code, and those to use instead."),
    ] = {}
    params: Annotated[
        Mapping[str, Any], says("Its ROS 2 parameters; {a: {b: 1}} is a.b.")
    ] = {}
    params_files: Annotated[
        tuple[Annotated[str, note(min_length=1)], ...],
        says("Files of ROS 2 parameters, relative to the robot file."),
    ] = ()
    arguments: Annotated[
        tuple[str, ...], says("Further arguments of the executable.")
    ] = ()

    def names(self) -> tuple[str, ...]:
        """Return name, namespace and remappings as ROS 2 takes them."""
        remaps = {
            **({"__node": self.name} if self.name else {}),
            **({"__ns": self.namespace} if self.namespace else {}),
            **self.remap,
        }
        words = [w for one, new in remaps.items() for w in ("-r", f"{one}:={new}")]
        for file in self.params_files:
            words += ["--params-file", file]
        return ("--ros-args", *words) if words else ()

    def command(self) -> tuple[str, ...]:
        """Return its command line; the program may be ``ros2:package/executable``."""
        program = [self.executable]
        if self.package:
            program = [f"ros2:{self.package}/{self.executable}"]
        elif self.executable.endswith(".py"):
            program = ["python", self.executable]
        return (*program, *self.arguments, *self.names(), *as_arguments(self.params))


def as_arguments(params: Mapping[str, Any]) -> tuple[str, ...]:
    """Return parameters as ROS 2 takes them on a command line."""
    words = [
        word
        for name, value in flat(params)
        for word in ("-p", f"{name}:={json.dumps(value, ensure_ascii=False)}")
    ]
    return ("--ros-args", *words) if words else ()


def flat(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield parameters by their full names: {a: {b: 1}} is ``a.b``."""
    for key, value in params.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


_PARAMETER = rf"/?{_WORD}((:|[./]|\./){_WORD})*"
_PLAIN = bool, int, float, str


def wrong_parameters(params: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield each parameter that ROS 2 does not take, and why."""
    for name, value in flat(params):
        if not re.fullmatch(_PARAMETER, name):
            yield name, "is no name of a parameter: letters, digits, '_', '.' and '/'"
        kinds = {type(each) for each in (value if isinstance(value, list) else [value])}
        if not kinds:
            yield name, "is an empty list, of which ROS 2 knows no type: leave it out"
        elif not kinds <= {*_PLAIN}:
            yield name, "is no bool, number or text, and no list of them"
        elif len(kinds) > 1:
            yield name, "is a list of several types: write all as one, as in [1.0, 2.5]"
