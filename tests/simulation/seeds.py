"""Runs seeds in a process of its own, which imports this by its name."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from tests.simulation.conftest import small_scenario
from tests.simulation.simulated_run import RunOutcome, simulate

SECONDS = 120.0
"""Of faults in each run [virtual s]."""


def chunk(
    seeds: Iterable[int], seconds: float = SECONDS, *, elects: bool = False
) -> list[RunOutcome]:
    """Run some seeds; what a replay needs is left out of what went well."""
    return [run(seed, seconds, elects=elects) for seed in seeds]


def run(seed: int, seconds: float = SECONDS, *, elects: bool = False) -> RunOutcome:
    """Run one seed; what agents log about their containers is in the trace."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        return simulate(small_scenario(seconds, elects=elects), seed)
    finally:
        logging.disable(before)
