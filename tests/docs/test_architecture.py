"""The files that the pages on design name are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs/design").glob("*.md"))
PARTS = ("", "plan", "plan/core", "simulation")
PLACES = (ROOT, ROOT / "benchmarks", *(ROOT / "src/poise" / part for part in PARTS))
NAMES = {file.name for file in (ROOT / "src").rglob("*.*")}
FILE = re.compile(r"`([\w./-]+\.(?:py|h|cpp|js|yaml|toml))`")
FOLDER = re.compile(r"`((?:[\w-]+/)+)`")


def is_there(path: str) -> bool:
    """Return whether a path leads somewhere, or a bare name is that of a file."""
    return any((place / path).exists() for place in PLACES) or path in NAMES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_and_folders_are_there(page: Path) -> None:
    text = page.read_text()
    named = [*FILE.findall(text), *FOLDER.findall(text)]
    assert [path for path in named if not is_there(path)] == []
