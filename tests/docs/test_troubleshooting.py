"""The messages that the page on troubleshooting explains are those of the code."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/troubleshooting.md").read_text()
MESSAGES = re.findall(r"^\| `([^`]+)` \|", PAGE, re.MULTILINE)


def texts() -> Iterator[str]:
    """Yield the texts of the code, with a NUL for what is filled in."""
    for file in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr):
                yield "".join(
                    str(part.value) if isinstance(part, ast.Constant) else "\0"
                    for part in node.values
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


@functools.cache
def all_texts() -> str:
    """Return them all."""
    return "\n".join(texts())


@pytest.mark.parametrize("message", MESSAGES)
def test_the_code_says_so(message: str) -> None:
    parts = [part.strip(" ;:.,()") for part in message.split("…")]
    longest = max(parts, key=len)
    assert len(longest) > 8
    for part in parts:
        if len(part) > 4:
            assert part in all_texts(), part


def test_explains_many() -> None:
    assert len(MESSAGES) > 30
