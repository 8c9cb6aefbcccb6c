"""Parameters of the type that a class declares."""

from __future__ import annotations

import pytest

from poise import Component, Message
from poise.clock import SystemClock
from poise.errors import UsageError
from poise.runtime.component.component import (
    Context,
    _like,
    create,
    set_parameters,
    shown_parameters,
)
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


class Node(Component):
    """Is started by a parameter that is none of its own."""

    _start_parameters = frozenset({"ros2"})

    def reconfigure(self, parameters: object) -> None: ...


def test_how_a_node_is_started_is_no_parameter_of_it() -> None:
    given = {"ros2": {"node": "a:B"}, "gain": 1.0}
    context = Context(
        name="node",
        parameters=given,
        devices={},
        clock=SystemClock(),
        measure=lambda *_: None,
    )
    node = create(Node, context)
    assert shown_parameters(node) == {"gain": 1.0}
    with pytest.raises(UsageError, match="no parameter 'ros2'; it has 'gain'"):
        set_parameters(node, {"ros2": {}})
    set_parameters(node, {"gain": 2})
    assert node.parameters == {"ros2": {"node": "a:B"}, "gain": 2.0}


def test_whole_numbers_in_a_list_of_real_ones_are_real() -> None:
    context = Context(
        name="node",
        parameters={"gains": [0.5, 1.0], "sizes": [1]},
        devices={},
        clock=SystemClock(),
        measure=lambda *_: None,
    )
    node = create(Node, context)
    set_parameters(node, {"gains": [2, 3], "sizes": [4]})
    assert repr(node.parameters) == "{'gains': [2.0, 3.0], 'sizes': [4]}"


def test_all_that_is_missing_is_said() -> None:
    with pytest.raises(UsageError, match=r"'least' is missing; .*'most' is missing"):
        as_declared(Ranged, {})


def test_what_the_type_checks_itself_is_said() -> None:
    with pytest.raises(UsageError, match=r"Ranged: 2\.0 is above 1\.0"):
        as_declared(Ranged, {"least": 2, "most": 1})


class Positive(Message):
    gain: float

    def __post_init__(self) -> None:
        assert self.gain > 0, "it would swing"


class Swinging(Component):
    parameters: Positive


def test_so_is_what_it_asserts() -> None:
    with pytest.raises(UsageError, match=r"Swinging: AssertionError: it would swing"):
        as_declared(Swinging, {"gain": -1})


def test_a_parameter_that_was_a_real_number_stays_one() -> None:
    before = {"rate": 10.0, "count": 1, "on": 0.5, "inner": {"gain": 2.0}}
    after = {"rate": 5, "count": 2, "on": True, "inner": {"gain": 3, "new": 4}}
    now = {"rate": 5.0, "count": 2, "on": True, "inner": {"gain": 3.0, "new": 4}}
    assert repr(_like(before, after)) == repr(now)
