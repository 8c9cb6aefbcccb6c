"""What explorations share."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


@pytest.fixture
def keeps_garbage() -> Iterator[None]:
    """Let nobody look for cycles in hundreds of thousands of states: there are none."""
    gc.disable()
    yield
    gc.enable()
    gc.collect()
