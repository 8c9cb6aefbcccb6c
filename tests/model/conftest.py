"""Robot files with one mark `▸` where the problem is expected."""

from collections.abc import Callable
from pathlib import Path

import pytest

from poise.errors import FileProblem, RobotError
from poise.model import load

MARK = "▸"

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]


@pytest.fixture
def find(tmp_path: Path) -> Find:
    """Return a function that gives the problems of a robot file's text."""

    def find_problems(text: str) -> tuple[FileProblem, ...]:
        path = tmp_path / "robot.yaml"
        path.write_text(text, encoding="utf-8")
        try:
            load(path)
        except RobotError as error:
            return error.problems or pytest.fail("a RobotError without problems")
        return ()

    return find_problems


@pytest.fixture
def refuse(find: Find, tmp_path: Path) -> Refuse:
    """Return a check: the one problem lies at the mark and says these words."""

    def refuse_text(text: str, *words: str) -> None:
        before = text[: text.index(MARK)]
        line = before.count("\n") + 1
        column = len(before) - before.rfind("\n")
        problems = find(text.replace(MARK, ""))
        told = "\n".join(map(str, problems))
        where = [(p.file, p.line, p.column) for p in problems]
        assert where == [(str(tmp_path / "robot.yaml"), line, column)], told
        assert all(word in problems[0].message for word in words), told

    return refuse_text
