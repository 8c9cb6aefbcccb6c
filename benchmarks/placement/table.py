"""Tables and timing that the placement benchmarks share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table in Markdown, as it goes into the documents."""
    print(f"### {title}\n")
    print("| " + " | ".join(head) + " |")
    print("| " + " | ".join("---" for _ in head) + " |")
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    print(flush=True)


def best_of(
    call: Callable[[], object],
    times: int,
    clock: Callable[[], float] = perf_counter,
) -> float:
    """Return the least time [s] that `call` took: what others do is only ever added."""
    least = float("inf")
    for _ in range(times):
        start = clock()
        call()
        least = min(least, clock() - start)
    return least


def microseconds(seconds: float) -> str:
    """Return a time for a table, in the unit that suits it."""
    if seconds < 1e-3:
        return f"{seconds * 1e6:.1f} us"
    return f"{seconds * 1e3:.1f} ms" if seconds < 1 else f"{seconds:.2f} s"


def quantile(values: Sequence[float], share: float) -> float:
    """Return the value that `share` of `values` are at or below."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]
