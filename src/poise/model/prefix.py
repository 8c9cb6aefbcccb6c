"""Gives what an included file defines other names, so that it is included again."""

from __future__ import annotations

from collections.abc import Container, Iterator

from poise.errors import FileProblem
from poise.model.yaml_tree import Node, Scalar
from poise.suggest import listed

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
    """Prefix the names that a file defines with `prefix`, also where they are used."""
    assert isinstance(root.value, dict)  # noqa: S101 - the reader has seen to it
    for name in [name for name in root.value if name not in _SECTIONS]:
        problem = f"{name}: a file with a prefix has only {listed(_SECTIONS)}"
        problems.append(root.value.pop(name).place.problem(problem))
    architectures = [*_entries(root, "architectures")]
    components = {n for a in architectures for n in _mapping(a, "components")}
    devices = {*_mapping(root, "devices")}
    for architecture in architectures:
        for component in _entries(architecture, "components"):
            _refer(_mapping(component).get("devices"), devices, prefix)
        _rename(_mapping(architecture, "components"), prefix)
        _refer(_mapping(architecture).get("function"), _All(), prefix)
        _refer_ends(_mapping(architecture).get("connectors"), components, prefix)
    _refer_ends(_mapping(root).get("connectors"), components, prefix)
    for chain in _entries(root, "chains"):
        _refer(_mapping(chain).get("through"), components, prefix)
    for name in ("together", "apart"):
        _refer(_mapping(root).get(name), components, prefix)
    for bridge in _items(_mapping(root, "ros2").get("bridges")):
        _refer(_mapping(bridge).get("port"), components, prefix)
    for name in ("devices", "architectures", "chains"):
        _rename(_mapping(root, name), prefix)


class _All:
    def __contains__(self, _: object) -> bool:
        return True


def _refer_ends(
    connectors: Node | None, components: Container[str], prefix: str
) -> None:
    for connector in _items(connectors):
        _refer(_mapping(connector).get("between"), components, prefix)


def _refer(node: Node | None, names: Container[str], prefix: str) -> None:
    """Prefix a name among `names`, also before a dot, or each in a list of such."""
    value = node.value if node is not None else None
    if isinstance(value, Scalar) and value.text.partition(".")[0] in names:
        assert node is not None  # noqa: S101 - it has a value
        node.value = Scalar(prefix + value.text, value.plain)
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


def _entries(node: Node, key: str) -> Iterator[Node]:
    yield from _mapping(node, key).values()


def _items(node: Node | None) -> Iterator[Node]:
    if node is not None and isinstance(node.value, list):
        yield from node.value
