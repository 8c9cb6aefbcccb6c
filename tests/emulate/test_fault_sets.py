"""What is refused of an emulated computer says what ends the fault that is there."""

from __future__ import annotations

import pytest

from poise.emulate import InjectedFault, emulated_set
from poise.emulate.registry import FaultKind


@pytest.mark.parametrize(
    ("kind", "on", "command"),
    [
        ("cut", ("left", "right"), "heal left right"),
        ("slow", ("left", "right"), "heal left right"),
        ("crashed", ("left",), "boot left"),
        ("frozen agent", ("left",), "boot left"),
        ("load", ("left",), "load left --cpu 0"),
    ],
)
def test_each_fault_says_what_ends_it(
    kind: FaultKind, on: tuple[str, ...], command: str
) -> None:
    fault = InjectedFault(kind=kind, on=on, since=0.0)
    assert fault.way_out == f"`poise emulate {command}` ends it"
    said = emulated_set._said([fault])
    assert str(fault) in said
    assert command in said
