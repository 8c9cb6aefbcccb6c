"""The glossary holds every word once."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

GLOSSARY = (Path(__file__).parents[2] / "docs/glossary.md").read_text()


def words() -> list[str]:
    cells = re.findall(r"^\| ([^|]+?) \|", GLOSSARY, re.MULTILINE)
    return [
        word
        for cell in cells
        for word in cell.split(", ")
        if word not in {"word", "---"}
    ]


def test_no_word_has_two_meanings() -> None:
    assert [word for word, times in Counter(words()).items() if times > 1] == []


def test_the_words_of_the_messages_are_there() -> None:
    """What the manager tells a container are words that people read in the journal."""
    assert {"hold", "retire", "order", "fault", "deployment"} <= {*words()}
