"""Read a plain problem from a JSON file (docs/problem-file.md)."""

from __future__ import annotations

from pathlib import Path

import msgspec

from poise.errors import RobotError
from poise.plan.check import check
from poise.plan.problem import Problem


def load(path: str | Path) -> Problem:
    """Return the problem in the JSON file at `path`.

    Raises
    ------
    RobotError
        When it cannot be read or anything in it is wrong; the message lists all.
    """
    try:
        problem = msgspec.json.decode(Path(path).read_bytes(), type=Problem)
    except OSError as error:
        raise RobotError(f"{path}: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RobotError(f"{path}: {error}") from error
    try:
        check(problem)
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None
    return problem
