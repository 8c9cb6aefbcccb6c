"""What tests of whole robots share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet, probe_host
from tests.manage.observe.conftest import steady

__all__ = ["steady"]


@pytest.fixture
def emulated(file: Path) -> Iterator[EmulatedSet]:
    """Return the emulated computers of a test's robot `file`."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    with poise.emulated(poise.load(file), say=print) as emulated:
        yield emulated
