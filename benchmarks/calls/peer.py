"""One of the two processes of a case: ``python -m benchmarks.calls.peer WORK``.

It ends when its standard input does, so that nothing outlives the benchmark.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from importlib import import_module
from pathlib import Path

import msgspec

from benchmarks.calls.timing import Times, measure


class Work(msgspec.Struct, frozen=True):
    """What a process of a case does; `counts` maps sizes [B] to round trips."""

    role: str
    module: str
    folder: str
    cpu: int
    counts: dict[int, int]


def main() -> None:
    """Serve, or connect and measure; tell by a line that it is done."""
    parser = argparse.ArgumentParser("python -m benchmarks.calls.peer")
    parser.add_argument("work", help="what `benchmarks.calls` wants of it, in JSON")
    work = msgspec.json.decode(parser.parse_args().work, type=Work)
    os.sched_setaffinity(0, {work.cpu})
    threading.Thread(target=_end_with_input, daemon=True).start()
    system = import_module(f"benchmarks.calls.systems.{work.module}")
    folder = Path(work.folder)
    if work.role == "serve":
        system.serve(folder, lambda: _tell([]))
        return
    with system.connect(folder) as trips:
        _tell([measure(trips, size, num) for size, num in work.counts.items()])
        threading.Event().wait()


def _tell(times: list[Times]) -> None:
    sys.stdout.write(msgspec.json.encode(times).decode() + "\n")
    sys.stdout.flush()


def _end_with_input() -> None:
    os.read(0, 1)
    os._exit(0)


if __name__ == "__main__":
    main()
