"""Refuses arguments that no later step could explain."""

from __future__ import annotations

import re
from collections.abc import Iterable
from math import inf
from numbers import Real
from os import PathLike
from reprlib import repr as short
from types import UnionType

from poise.endpoint import NAME, NAME_SAYS
from poise.errors import UsageError
from poise.units import quoted


def check_type(name: str, value: object, kind: type | UnionType, is_what: str) -> None:
    """Raise UsageError for an argument of another type than it is declared with."""
    if not isinstance(value, kind):
        raise UsageError(f"{name}={short(value)}: it must be {is_what}")


def check_amount(name: str, value: object) -> None:
    """Raise UsageError unless a number is 0 or more, and finite."""
    check_type(name, value, Real, "a number")
    if not 0 <= float(value) < inf:  # type: ignore[arg-type]
        raise UsageError(f"{name}={value}: it must be 0 or more, and finite")


def check_path(name: str, value: object) -> None:
    """Raise UsageError for what is no path, such as an open file."""
    check_type(name, value, str | PathLike, "a path: a text or a `pathlib.Path`")


def check_names(name: str, value: object) -> None:
    """Raise UsageError for a text, which would be read letter by letter."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise UsageError(f"{name}={short(value)}: it must be a list of names")


def check_name(name: str, is_what: str, option: str = "") -> None:
    """Raise UsageError for what a robot file may not call a robot or a computer."""
    if not re.fullmatch(NAME, name):
        given = f"{option} {quoted(name)}".strip()
        raise UsageError(f"{given} is not {is_what}: {NAME_SAYS}")


def check_robot(robot: object) -> None:
    """Raise UsageError for what is no robot, such as the name of its file."""
    from poise.model.robot import Robot  # noqa: PLC0415, an agent checks names only

    if not isinstance(robot, Robot):
        raise UsageError(f"{robot!r} is not a robot: `poise.load(FILE)` returns one")


def check_task(task: object) -> None:
    """Raise UsageError for what cannot name a task, such as a list of them."""
    if not isinstance(task, str | None):
        raise UsageError(f"{task!r} is not the name of a task")


def check_duration(what: str, seconds: object) -> None:
    """Raise UsageError unless a time is above 0 s, and finite."""
    if not isinstance(seconds, Real):
        raise UsageError(f"{what} lasts a number of seconds, not {seconds!r}")
    if not 0 < float(seconds) < inf:
        raise UsageError(f"{seconds:g} s: {what} must last longer than 0 s, and end")
