"""What an include gives a file: values where it says `$(name)`, and a prefix."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping
from typing import Annotated

from msgspec import Struct

from poise.errors import FileProblem, did_you_mean, listed, unknown
from poise.model.file_keys import Name, says
from poise.model.yaml_tree import Node, Scalar

_SECTIONS = (
    "arguments",
    "devices",
    "architectures",
    "connectors",
    "chains",
    "together",
    "apart",
    "ros2",
)


def add_prefix(root: Node, prefix: str, problems: list[FileProblem]) -> None:
    """Prefix the names that a file defines, where it uses them, too; no others."""
    assert isinstance(root.value, dict)  # noqa: S101 - the reader has seen to it
    for name in [name for name in root.value if name not in _SECTIONS]:
        problem = f"{name}: a file with a prefix has only {listed(_SECTIONS)}"
        problems.append(root.value.pop(name).place.problem(problem))
    architectures = [*_mapping(root, "architectures").values()]
    components = {n for a in architectures for n in _mapping(a, "components")}
    devices = {*_mapping(root, "devices")}
    for architecture in architectures:
        for component in _mapping(architecture, "components").values():
            _refer(_mapping(component).get("devices"), devices, prefix)
        _rename(_mapping(architecture, "components"), prefix)
        _refer(_mapping(architecture).get("function"), None, prefix)
        _refer_ends(_mapping(architecture).get("connectors"), components, prefix)
    _refer_ends(_mapping(root).get("connectors"), components, prefix)
    for chain in _mapping(root, "chains").values():
        _refer(_mapping(chain).get("through"), components, prefix)
    for name in ("together", "apart"):
        _refer(_mapping(root).get(name), components, prefix)
    for bridge in _items(_mapping(root, "ros2").get("bridges")):
        _refer(_mapping(bridge).get("port"), components, prefix)
    for name in ("devices", "architectures", "chains"):
        _rename(_mapping(root, name), prefix)


def _refer_ends(
    connectors: Node | None, components: Container[str], prefix: str
) -> None:
    for connector in _items(connectors):
        _refer(_mapping(connector).get("between"), components, prefix)


def _refer(node: Node | None, names: Container[str] | None, prefix: str) -> None:
    """Prefix a name among `names` (None: any), also before a dot, or each in a list."""
    if node is not None and isinstance(node.value, Scalar):
        text = node.value.text
        if names is None or text.partition(".")[0] in names:
            node.value = Scalar(prefix + text, node.value.plain)
    for item in _items(node):
        _refer(item, names, prefix)


def _rename(entries: dict[str, Node], prefix: str) -> None:
    """Prefix the keys of a mapping, in place."""
    renamed = {prefix + name: node for name, node in entries.items()}
    entries.clear()
    entries.update(renamed)


def _mapping(node: Node | None, *keys: str) -> dict[str, Node]:
    """Return the mapping under `keys`; an empty one where there is none."""
    for key in keys:
        node = _mapping(node).get(key)
    return node.value if node is not None and isinstance(node.value, dict) else {}


def _items(node: Node | None) -> Iterator[Node]:
    if node is not None and isinstance(node.value, list):
        yield from node.value


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


def given_in(item: Node) -> Given:
    """Return the arguments that an entry of `include` gives, quoted ones as texts."""
    nodes = _mapping(item, "arguments").items()
    return {n: node.value for n, node in nodes if isinstance(node.value, Scalar)}


def fill(
    root: Node, given: Given, problems: list[FileProblem], *, is_top: bool
) -> None:
    """Put the values of a file's arguments where it refers to them.

    An included file may refer to those of the file above, too: what it does not have
    stays as it is, unless `is_top`.
    """
    values = arguments_of(root, given, problems, is_top=is_top)
    for name, node in _mapping(root).items():
        if name != "arguments":
            _fill(node, values, problems, is_top=is_top)


def arguments_of(
    root: Node, given: Given, problems: list[FileProblem], *, is_top: bool
) -> dict[str, Scalar]:
    """Put the given values into a file's arguments, and return them all."""
    values: dict[str, Scalar] = {}
    for name, node in _mapping(root, "arguments").items():
        _fill(node, values, problems, is_top=is_top)
        if isinstance(node.value, Scalar):
            node.value = values[name] = given.get(name, node.value)
    return values


def fill_include(item: Node, values: Given, problems: list[FileProblem]) -> None:
    """Put the values of arguments into an entry of `include`."""
    for name, node in (_mapping(item) or {"file": item}).items():
        _fill(node, values, problems, is_top=name != "arguments")


def unknown_arguments(root: Node, given: Given) -> dict[str, str]:
    """Return what is wrong with arguments that a file does not have."""
    known = _mapping(root, "arguments")
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
