"""Arguments of a robot file: `$(name)` in it stands for a value that may be given."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated

from msgspec import Struct

from poise.errors import FileProblem
from poise.model.file_keys import Name, says
from poise.model.yaml_tree import Node, Scalar
from poise.suggest import did_you_mean, unknown

_REFERENCE = re.compile(r"(\$?)\$\((\w+)\)")

Given = Mapping[str, Scalar]
"""Argument -> the value that is used instead of its default."""


class Include(Struct, frozen=True, kw_only=True):
    """A further file of the robot, with values for its arguments.

    With a prefix its devices, architectures, functions, components and chains have
    other names, so that one file describes several alike.
    """

    file: Annotated[str, says("The file, relative to this one.", min_length=1)]
    prefix: Annotated[
        Name, says("What its names begin with: left_.", is_nullable=True)
    ] = ""
    arguments: Annotated[Mapping[Name, str], says("Values for its arguments.")] = {}


def as_given(arguments: Mapping[str, object]) -> Given:
    """Return arguments as if they were written in a file."""
    texts = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in arguments.items()
    }
    return {name: Scalar(text, plain=True) for name, text in texts.items()}


def fill(
    root: Node, given: Given, problems: list[FileProblem], *, is_top: bool
) -> None:
    """Put the values of a file's arguments where it refers to them."""
    assert isinstance(root.value, dict)  # noqa: S101 - the reader has seen to it
    defaults = root.value.get("arguments")
    values: dict[str, Scalar] = {}
    if defaults is not None and isinstance(defaults.value, dict):
        for name, node in defaults.value.items():
            _fill(node, values, problems, is_top=is_top)
            if isinstance(node.value, Scalar):
                node.value = values[name] = given.get(name, node.value)
    for name, node in root.value.items():
        if name != "arguments":
            _fill(node, values, problems, is_top=is_top)


def unknown_arguments(root: Node, given: Given) -> dict[str, str]:
    """Return what is wrong with arguments that a file does not have."""
    assert isinstance(root.value, dict)  # noqa: S101 - the reader has seen to it
    node = root.value.get("arguments")
    known = node.value if node is not None and isinstance(node.value, dict) else {}
    return {n: unknown("argument", n, known) for n in given if n not in known}


def _fill(
    node: Node, values: Given, problems: list[FileProblem], *, is_top: bool
) -> None:
    if isinstance(node.value, Scalar):
        if "$(" in node.value.text:
            node.value = _filled(node, node.value, values, problems, is_top=is_top)
        return
    inner = node.value.values() if isinstance(node.value, dict) else node.value
    for entry in inner:
        _fill(entry, values, problems, is_top=is_top)


def _filled(
    node: Node,
    scalar: Scalar,
    values: Given,
    problems: list[FileProblem],
    *,
    is_top: bool,
) -> Scalar:
    whole = _REFERENCE.fullmatch(scalar.text)
    if whole and scalar.plain and not whole[1] and whole[2] in values:
        return values[whole[2]]  # a number stays one

    def value_of(match: re.Match[str]) -> str:
        escape, name = match.groups()
        if escape:
            return match[0][1:] if is_top else match[0]
        if name in values:
            return values[name].text
        if is_top:
            problems.append(
                node.place.problem(
                    f"there is no argument '{name}'{did_you_mean(name, values)}: "
                    f"declare it, as in `arguments: {{{name}: its default}}`, or write "
                    f"$$({name}) for the text"
                )
            )
        return match[0]

    return Scalar(_REFERENCE.sub(value_of, scalar.text), scalar.plain)
