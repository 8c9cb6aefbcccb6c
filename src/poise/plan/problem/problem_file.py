"""The problem file (docs/problem-file.md): reading it, and its JSON Schema."""

from __future__ import annotations

from pathlib import Path

import msgspec

from poise.errors import RobotError
from poise.plan.problem.problem import Problem


def load(path: str | Path) -> Problem:
    """Return the problem in the JSON file at `path`.

    Raises
    ------
    RobotError
        When it cannot be read or anything in it is wrong; the message lists all.
    """
    try:
        return msgspec.json.decode(Path(path).read_bytes(), type=Problem)
    except OSError as error:
        raise RobotError(f"{path}: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RobotError(f"{path}: {error}") from error
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None


def schema() -> str:
    """Return the JSON Schema of what `load` reads, as indented JSON."""
    found = msgspec.json.schema(Problem)
    whole = {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
    return msgspec.json.format(msgspec.json.encode(whole), indent=2).decode() + "\n"
