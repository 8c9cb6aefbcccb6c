"""What tests of whole robots share."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet, Emulation, probe_host
from poise.model.robot import Computer, Robot
from tests.manage.observe.conftest import steady

__all__ = ["steady"]


@pytest.fixture
def emulated(file: Path) -> Iterator[EmulatedSet]:
    """Return the emulated computers of a test's robot `file`."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    with poise.emulated(poise.load(file), say=print) as emulated:
        yield emulated


@contextlib.contextmanager
def bare_computers(names: Iterable[str], folder: Path) -> Iterator[Emulation]:
    """Emulate computers of half a core, on which nothing of a robot runs yet."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    computers = tuple(
        Computer(name=name, capacity={"cpu": 0.5, "memory": 512e6}) for name in names
    )
    with Emulation(Robot(name="bare", computers=computers), folder) as emulation:
        yield emulation
