"""Values without a declared type in a robot file (`parameters`)."""

from __future__ import annotations

import re
from typing import Any

from poise.model.yaml.tree import Node, Scalar
from poise.units import quoted

NULLS = ("", "~", "null")
_WORDS = dict.fromkeys(NULLS) | {"true": True, "false": False}
_INTEGER = re.compile(r"[+-]?[0-9]+")
_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_LARGEST = 2**63
_DIGITS = 19


def plain_value(node: Node) -> Any:  # noqa: ANN401, any value of YAML
    """Return the node as dicts, lists, text, numbers, truth values and None.

    Scalars follow YAML 1.2: ``yes`` is a text, ``1e3`` a number.

    Raises
    ------
    ValueError
        For a whole number that does not fit into 64 bits, or an infinite one.
    """
    if isinstance(node.value, dict):
        return {key: plain_value(entry) for key, entry in node.value.items()}
    if isinstance(node.value, list):
        return [plain_value(item) for item in node.value]
    return _scalar(node.value)


def _scalar(scalar: Scalar) -> Any:  # noqa: ANN401, any scalar of YAML
    text = scalar.text
    if not scalar.plain:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        if len(text.lstrip("+-0")) > _DIGITS or not -_LARGEST <= int(text) < _LARGEST:
            raise ValueError(f"{quoted(text)} does not fit into 64 bits")
        return int(text)
    if _FLOAT.fullmatch(text):
        if float(text) in (float("inf"), float("-inf")):
            raise ValueError(f"{quoted(text)} is too large for a number")
        return float(text)
    return text
