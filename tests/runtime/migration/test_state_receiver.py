"""Which states fit is told by types."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from poise import Message
from poise.errors import UsageError
from poise.runtime.migration.state_check import check_fits, describe_type, types_of


class Belief(Message):
    pose: float


class Before(Message):
    localiser: Belief


class After(Message):
    tracker: Belief


def adapt(before: Before) -> After:
    return After(before.localiser)


def untyped(before):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    return before


def of_two(one: Before, two: Before) -> After:  # noqa: ARG001
    return After(one.localiser)


class Colour(Enum):
    """Has a method, as an interface does."""

    RED = "red"

    def shade(self) -> str:
        return self.value


class Mixed(Message):
    of: dict[str, int]
    at: Belief | None
    names: list[str]
    colour: Colour
    raw: bytes


def of_a_number(number: int) -> After:
    return After(Belief(number))


def test_the_fields_name_the_components() -> None:
    assert types_of(adapt) == ({"localiser": Belief}, {"tracker": Belief})


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (untyped, "its parameter and its result must be message classes"),
        (of_a_number, "its parameter and its result must be message classes"),
        (of_two, "must take one argument"),
    ],
)
def test_says_what_is_wrong_with_a_function(
    function: Callable[..., Any], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        types_of(function)


@pytest.mark.parametrize(
    ("state", "taken"),
    [
        (Belief(1.0), Belief),
        (Belief(1.0), Belief | None),
        (7, int),
        ((1, 2), tuple[int, int]),
        ([1.0], list[float]),
        ({"a": 1}, dict[str, int]),
        ({"a": 1}, dict[str, int] | None),
        (np.zeros(2), NDArray[np.float64]),
    ],
)
def test_a_state_fits_what_restores_its_type(state: Any, taken: Any) -> None:
    kind: Any = type(state)
    check_fits(describe_type(kind), taken, "restore")


@pytest.mark.parametrize("taken", [int, list[float], Belief])
def test_a_state_of_another_type_does_not(taken: Any) -> None:
    with pytest.raises(UsageError, match="restore takes"):
        check_fits(describe_type(tuple), taken, "restore")


def test_says_in_the_words_of_code_what_a_state_is_made_of() -> None:
    """It said `of: ("<class 'dict'>", ('str', 'int'))`."""
    words = (
        "(of: dict[str, int], at: Belief(pose: float) | NoneType, "
        "names: list[str], colour: Colour, raw: bytes)"
    )
    assert describe_type(Mixed) == words
