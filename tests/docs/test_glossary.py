"""The glossary stays short, and holds every word once."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

GLOSSARY = (Path(__file__).parents[2] / "docs/glossary.md").read_text()
WORDS = [
    word
    for word in re.findall(r"^\| ([^|]+?) \|", GLOSSARY, re.MULTILINE)
    if word not in {"word", "---"}
]


def test_no_word_has_two_meanings() -> None:
    assert [word for word, times in Counter(WORDS).items() if times > 1] == []


def test_the_glossary_holds_only_what_an_engineer_would_not_know() -> None:
    assert 30 <= len(WORDS) <= 45
