"""The documents, and what is written in them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

Write = Callable[[str, Path], list[str]]


@pytest.fixture
def write_files() -> Write:
    """Return what writes a document's files: blocks that follow a name."""

    def write(document: str, folder: Path) -> list[str]:
        text = (ROOT / document).read_text()
        found = re.findall(r"`([\w.]+)`:\n\n```\w+\n(.*?)```", text, re.DOTALL)
        for name, content in found:
            (folder / name).write_text(content)
        return [name for name, _ in found]

    return write
