"""Parameters of the type that a class declares."""

from __future__ import annotations

import pytest

from poise import Component, Message
from poise.errors import UsageError
from poise.runtime.component.component import _like
from poise.runtime.component.parameters import as_declared


class Range(Message):
    least: float
    most: float
    period: float = 0.1

    def __post_init__(self) -> None:
        if self.least > self.most:
            raise ValueError(f"{self.least} is above {self.most}")


class Ranged(Component):
    parameters: Range


def test_quantities_have_units() -> None:
    given = {"least": "5%", "most": 1, "period": "20 ms"}
    assert as_declared(Ranged, given) == Range(0.05, 1.0, 0.02)


def test_all_that_is_missing_is_said() -> None:
    with pytest.raises(UsageError, match=r"'least' is missing; .*'most' is missing"):
        as_declared(Ranged, {})


def test_what_the_type_checks_itself_is_said() -> None:
    with pytest.raises(UsageError, match=r"Ranged: 2\.0 is above 1\.0"):
        as_declared(Ranged, {"least": 2, "most": 1})


def test_a_parameter_that_was_a_real_number_stays_one() -> None:
    before = {"rate": 10.0, "count": 1, "on": 0.5, "inner": {"gain": 2.0}}
    after = {"rate": 5, "count": 2, "on": True, "inner": {"gain": 3, "new": 4}}
    now = {"rate": 5.0, "count": 2, "on": True, "inner": {"gain": 3.0, "new": 4}}
    assert repr(_like(before, after)) == repr(now)
