"""Runs seeds in a process of its own, which imports this by its name."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Literal

from msgspec import structs

from tests.simulation.conftest import small_scenario
from tests.simulation.simulated_run import RunOutcome, Scenario, simulate
from tests.simulation.varied_robots import varied_scenario
from tests.simulation.wild_robots import wild_scenario

SECONDS = 120.0
"""Of faults in each run [virtual s]."""


Kind = Literal["small", "elects", "varied", "wild", "watched", "restarted"]
"""The robot of all seeds, the same with standbys, or another one for each seed."""


def scenario_of(seed: int, seconds: float, kind: Kind) -> Scenario:
    """Return what a seed runs, but for its chance."""
    if kind == "varied":
        return varied_scenario(seed, seconds)
    if kind == "wild":
        return wild_scenario(seed, seconds)
    if kind == "watched":
        return structs.replace(wild_scenario(seed, seconds), is_watched=True)
    if kind == "restarted":
        wild = wild_scenario(seed, seconds)
        kinds = (*wild.kinds, *["restart computer"] * 8)
        return structs.replace(wild, is_watched=seed % 2 == 0, kinds=kinds)
    return small_scenario(seconds, elects=kind == "elects")


def chunk(
    seeds: Iterable[int], seconds: float = SECONDS, kind: Kind = "small"
) -> list[RunOutcome]:
    """Run some seeds; what a replay needs is left out of what went well."""
    return [run(seed, seconds, kind) for seed in seeds]


def run(seed: int, seconds: float = SECONDS, kind: Kind = "small") -> RunOutcome:
    """Run one seed; what agents log about their containers is in the trace."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        return simulate(scenario_of(seed, seconds, kind), seed)
    finally:
        logging.disable(before)
