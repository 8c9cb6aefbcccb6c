"""What a leased component pays: `python -m benchmarks.lease`.

It reads its lease before each handler, and before each message or call that leaves or
enters its container. It imports internal modules: that read has no public name. The
least of interleaved rounds: what else runs only adds to it.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from timeit import timeit

from poise.runtime.execution.container_lease import LeaseEnd, check_lease
from poise.runtime.execution.counters import new_memory

_ROUNDS = 50
_CALLS = 50_000


def _nothing() -> None:
    pass


def main() -> None:
    """Print each way to read a lease with its time [ns]."""
    argparse.ArgumentParser(
        prog="python -m benchmarks.lease", description=__doc__
    ).parse_args()
    memory = new_memory()
    lease = LeaseEnd(memory)
    os.close(memory)
    lease.at = time.clock_gettime(time.CLOCK_BOOTTIME) + 1e6
    cases: dict[str, Callable[[], object]] = {
        "empty function": _nothing,
        "before a handler": lease.is_past,
        "before a message or call": partial(check_lease, lease, "component"),
        "not leased": partial(check_lease, None, "component"),
    }
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(_ROUNDS):
        for name, case in cases.items():
            seconds[name].append(timeit(case, number=_CALLS) / _CALLS)
    for name, times in seconds.items():
        print(f"{name:>25}: {1e9 * min(times):5.0f} ns")


if __name__ == "__main__":
    main()
