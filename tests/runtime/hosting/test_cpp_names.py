"""What stands in Python for classes, parameters and names in C++."""

from __future__ import annotations

from typing import Any, Protocol

import msgspec
import pytest

from poise.errors import UsageError
from poise.runtime.hosting.cpp_component import component, message


class Heating(Protocol):
    def heat(self) -> None: ...


TIMER = ("tick", 0.5, None)


@pytest.mark.parametrize(
    ("declared", "name"),
    [
        ({"timers": [TIMER, TIMER]}, "tick"),
        ({"timers": [TIMER], "subscribed": [("tick", "keep", 1, int)]}, "tick"),
        ({"timers": [("heat", 1.0, None)], "provided": {"stove": Heating}}, "heat"),
    ],
)
def test_two_of_one_name_are_refused(declared: dict[str, Any], name: str) -> None:
    kinds = ("published", "required", "provided", "hooks")
    types: dict[str, Any] = {kind: {} for kind in kinds}
    types |= {"latest": [], "subscribed": [], "timers": []} | declared
    with pytest.raises(UsageError, match=f"Stove: two of .* are named '{name}'"):
        component("Stove", "kitchen", types, lambda _: ({}, print, None))


def test_parameters_may_have_a_list_by_default() -> None:
    gains = message("Gains", "kitchen", {"gains": list[float]}, {"gains": [0.5]})
    assert msgspec.to_builtins(msgspec.convert({}, gains)) == {"gains": [0.5]}
