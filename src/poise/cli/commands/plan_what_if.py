"""The what-if options of `poise plan`: other computers, and other capacities."""

from __future__ import annotations

from math import isfinite

from poise import plan, units
from poise.errors import UsageError
from poise.model.robot import Computer


def changed_problem(
    problem: plan.Problem, without: list[str], add: list[str], scale: list[str]
) -> plan.Problem:
    """Return the problem without computers, with others, and with other capacities."""
    if without:
        problem = plan.without(problem, without)
    for text in add:
        problem = plan.add(problem, _computer(text))
    if scale:
        problem = plan.scale(problem, dict(_factor(text) for text in scale))
    return problem


def _computer(text: str) -> Computer:
    """Return the computer that ``NAME:cpu=2,memory=4GiB`` describes."""
    name, colon, rest = text.partition(":")
    if not name or not colon:
        raise UsageError(f"--add {text!r}: write NAME:cpu=2,memory=4GiB")
    pairs = [_pair(f"--add {text!r}", part) for part in rest.split(",") if part]
    return Computer(
        name=name,
        capacity={key: _amount(f"--add {text!r}", key, value) for key, value in pairs},
    )


def _factor(text: str) -> tuple[str, float]:
    """Return the name and the factor of ``NAME=0.5``."""
    name, value = _pair(f"--scale {text!r}", text)
    try:
        number = float(value)
    except ValueError:
        number = -1.0
    if not (isfinite(number) and number >= 0):
        raise UsageError(f"--scale {text!r}: {value!r} is not a number >= 0")
    return name, number


def _pair(option: str, text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise UsageError(f"{option}: {text!r} is not NAME=VALUE")
    return key.strip(), value.strip()


def _amount(option: str, resource: str, value: str) -> float:
    known = {"cpu": units.CORES, "memory": units.BYTES}
    try:
        return units.parse(value, known.get(resource, units.NUMBER))
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from None
