"""All problems of a robot file and of the code that it names."""

from __future__ import annotations

from pathlib import Path

from poise.errors import Problem, RobotError
from poise.model.load import load_source
from poise.runtime.isolated_check import check_code_isolated


def find_problems(path: Path) -> tuple[Problem, ...]:
    """Return what is wrong with the file; when nothing is, what is with its code."""
    try:
        source = load_source(path)
    except RobotError as error:
        return error.problems
    findings = check_code_isolated(source.robot)
    return tuple(sorted(source.positions.problem(f) for f in findings))
