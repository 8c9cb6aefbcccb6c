"""Runs many seeds of a simulated robot: `make simulate`, `make simulate FOR=2h`.

    python -m tests.simulation 200         # 200 seeds
    python -m tests.simulation 2h          # for so long
    python -m tests.simulation --seed 71   # one, with its trace
    python -m tests.simulation 200 --robots elects   # standbys follow the manager
    python -m tests.simulation 200 --robots varied   # another robot for each seed
    python -m tests.simulation 200 --robots wild   # all is tight, slow or fails
    python -m tests.simulation 200 --robots restarted   # and computers lose their power
    python -m tests.simulation 200 --virtual 40s   # instead of two minutes each

Two processes work at a time. The first failures are shrunk and printed with their
traces; the exit code is 1 when there are any.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import count, islice
from typing import get_args

from poise.errors import UsageError
from poise.units import SECONDS as UNIT
from poise.units import parse
from tests.simulation.seeds import SECONDS, Kind, chunk, run, scenario_of
from tests.simulation.shrink import Shrunk
from tests.simulation.simulated_run import RunOutcome

SHRUNK = 3
"""So many failures are shrunk."""
WORKERS = 2
CHUNK = 5
"""Seeds that a process runs in one go."""


def main() -> int:
    """Run what the command line asks for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("extent", nargs="?", default="200", help="seeds, or a time")
    parser.add_argument("--seed", type=int, help="only this one, with its trace")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--robots", choices=get_args(Kind), default="small")
    parser.add_argument("--virtual", default=f"{SECONDS:g}s", help="of each seed")
    asked = parser.parse_args()
    seconds = parse(asked.virtual, UNIT)
    if asked.seed is not None:
        return replay(asked.seed, seconds, asked.robots)
    failures: list[int] = []
    virtual, runs, began = 0.0, 0, time.monotonic()
    seeds = in_parallel(asked.extent, asked.first, seconds, asked.robots)
    for outcome in seeds:
        runs, virtual = runs + 1, virtual + outcome.virtual
        if outcome.failure:
            failures.append(outcome.seed)
            what = f"{outcome.failure}: {outcome.message}"
            print(f"seed {outcome.seed}: {what}", flush=True)
    took = time.monotonic() - began
    print(
        f"{runs} seeds, {virtual / 60:.0f} virtual minutes in {took / 60:.1f}: "
        f"{virtual / took:.0f} times real time; {len(failures)} failed"
    )
    for seed in failures[:SHRUNK]:
        replay(seed, seconds, asked.robots)
    return bool(failures)


def in_parallel(
    extent: str, first: int, seconds: float, kind: Kind
) -> Iterator[RunOutcome]:
    """Yield outcomes as they come, until so many seeds or so much time are over."""
    most = int(extent) if extent.isdigit() else None
    until = time.monotonic() + (0.0 if most is not None else parse(extent, UNIT))
    seeds = count(first) if most is None else iter(range(first, first + most))
    waiting: set[Future[list[RunOutcome]]] = set()
    with ProcessPoolExecutor(WORKERS) as pool:
        while True:
            is_due = most is not None or time.monotonic() < until
            while is_due and len(waiting) < 2 * WORKERS:
                if not (part := list(islice(seeds, CHUNK))):
                    break
                waiting.add(pool.submit(chunk, part, seconds, kind))
            if not waiting:
                return
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for each in done:
                yield from each.result()


def replay(seed: int, seconds: float, kind: Kind) -> int:
    """Run a seed again, and print the shortest way to its failure."""
    outcome = run(seed, seconds, kind)
    if outcome.failure:
        logging.disable(logging.CRITICAL)  # it is in the trace
        shrunk = Shrunk(scenario_of(seed, seconds, kind), outcome)
        shrunk.shrink()
        outcome = shrunk.outcome
    print(f"--- seed {seed}: {outcome.failure or 'all held'} {outcome.message}")
    for fault in outcome.faults:
        print(f"    {fault}")
    for line in outcome.trace[-60:]:
        print(line)
    return bool(outcome.failure)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except UsageError as error:
        sys.exit(str(error))
