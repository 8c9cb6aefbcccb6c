"""What an architecture's alternative takes over is told by types."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from poise import Message
from poise.errors import UsageError
from poise.runtime.migration.state_check import types_of


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
