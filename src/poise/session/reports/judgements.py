"""How the simulated world judged a robot's tasks, or its functions."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import msgspec
from msgspec import Struct


class Measured(Struct, frozen=True):
    """A value that decided, None when it was not measured; with its unit or ""."""

    value: int | float | str | bool | None
    unit: str = ""

    def __str__(self) -> str:
        """Return it for people."""
        if self.value is None:
            return "not measured"
        return f"{self.value} {self.unit}".rstrip()


class Judgement(Struct, frozen=True, kw_only=True):
    """Whether a task or a function succeeded, and by what."""

    name: str
    success: bool
    values: Mapping[str, Measured] = {}


def judgements(
    simulation: Mapping[str, Any], tasks: Collection[str]
) -> list[Judgement]:
    """Return those of the tasks that ran, or else those of all functions.

    They are under ``tasks`` and ``criteria`` of the world's result; what is there in
    another form is the world's own affair.
    """
    of_tasks = [each for each in _found(simulation, "tasks") if each.name in tasks]
    return of_tasks or _found(simulation, "criteria")


def _found(simulation: Mapping[str, Any], key: str) -> list[Judgement]:
    try:
        return msgspec.convert(simulation.get(key, []), list[Judgement])
    except msgspec.ValidationError:
        return []
