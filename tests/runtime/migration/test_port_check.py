"""Ports of code that is to take the place of other code."""

from __future__ import annotations

from typing import Protocol

import pytest

from poise import Component, Message, Provided, Published, Required, subscribed
from poise.errors import UsageError
from poise.runtime.component.ports import ports_of
from poise.runtime.migration.executor import check_ports


class Scan(Message):
    ranges: list[float]


class Heating(Protocol):
    def heat(self, power: float) -> float: ...


class Before(Component):
    scan: Published[Scan]
    heating: Provided[Heating]

    def heat(self, power: float) -> float:
        return power


class Better(Before):
    """Publishes something more, as code that is connected to nobody may."""

    more: Published[Scan]


def same_again() -> type[Message]:
    class Scan(Message):
        ranges: list[float]

    Scan.__qualname__ = "Scan"
    return Scan


class Alike(Before):
    scan: Published[same_again()]  # type: ignore[valid-type]


class OtherMessage(Before):
    scan: Published[str]  # type: ignore[assignment]


class Cooling(Protocol):
    def heat(self, power: str) -> str: ...


class OtherMethods(Component):
    heating: Provided[Cooling]

    def heat(self, power: str) -> str:
        return power


class OtherWay(Component):
    heating: Required[Heating]


class Caller(Before):
    other: Required[Heating]


class Subscriber(Before):
    @subscribed(keep=1)
    def more(self, message: Scan) -> None: ...


def check(after: type[Component]) -> None:
    check_ports("eye", ports_of(Before), ports_of(after))


@pytest.mark.parametrize("after", [Before, Better, Alike])
def test_code_whose_ports_the_connectors_fit_takes_the_place(
    after: type[Component],
) -> None:
    check(after)


@pytest.mark.parametrize(
    ("after", "said"),
    [
        (OtherMessage, "publishes str, and before publishes Scan"),
        (OtherMethods, "provides Cooling, and before provides Heating"),
        (OtherWay, "requires Heating, and before provides Heating"),
        (Caller, "'eye.other' requires Heating, but no connector joins it"),
        (Subscriber, "'eye.more' subscribes Scan, but no connector joins it"),
    ],
)
def test_code_that_the_connectors_do_not_fit_is_refused(
    after: type[Component], said: str
) -> None:
    with pytest.raises(UsageError) as refused:
        check(after)
    assert said in str(refused.value)
