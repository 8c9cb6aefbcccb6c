"""Repeats the tests in random order on a busy machine; counts failures per test.

Nothing is tried again: each failure of each round is counted and its reason kept.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from poise.units import SECONDS, format_seconds, parse

PYTEST = (sys.executable, "-m", "pytest", "-q", "-n", "2")
OPTIONS = (
    "--hypothesis-profile",
    "soak",
    "--dist",
    "loadgroup",
    "--no-loadscope-reorder",
)
BURN = "while True: pass"


class Round(NamedTuple):
    """One run of the tests: how many there were, why tests failed, what was skipped."""

    tests: int
    failures: dict[str, str]
    skipped: int


def main(argv: Sequence[str] | None = None) -> int:
    """Repeat until the time is over; return 1 when a test failed."""
    told = _parser().parse_args(argv)
    end = time.monotonic() + parse(told.lasts, SECONDS)
    failed: Counter[str] = Counter()
    reasons: dict[str, str] = {}
    rounds = 0
    with _load(told.load), contextlib.suppress(KeyboardInterrupt):
        while not rounds or time.monotonic() < end:
            began, seed = time.monotonic(), told.seed + rounds
            done = _run(seed, told.tests)
            rounds += 1
            failed.update(done.failures)
            reasons |= done.failures
            print(
                f"round {rounds} (--shuffle {seed}, "
                f"{format_seconds(time.monotonic() - began)}): {done.tests} tests, "
                f"{len(done.failures)} failed, {done.skipped} skipped",
                *done.failures,
                sep="\n  ",
                flush=True,
            )
    print(f"\n{rounds} rounds, {len(failed)} tests failed at least once")
    for test, times in failed.most_common():
        print(f"{times:5} of {rounds}  {test}\n{'':12}{reasons[test]}")
    return 1 if failed else 0


def _run(seed: int, tests: Sequence[str]) -> Round:
    with tempfile.NamedTemporaryFile(suffix=".xml") as report:
        order = ["--shuffle", str(seed), f"--junitxml={report.name}"]
        done = subprocess.run(
            [*PYTEST, *OPTIONS, *order, *tests],
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        if Path(report.name).stat().st_size == 0:
            return Round(0, {"pytest": done.stdout[-1000:]}, 0)
        cases = list(ET.parse(report.name).iter("testcase"))
    failures, skipped = {}, 0
    for case in cases:
        skipped += case.find("skipped") is not None
        for fault in (*case.findall("failure"), *case.findall("error")):
            name = f"{case.get('classname', '')}::{case.get('name')}"
            failures[name] = fault.get("message", "").partition("\n")[0]
    if done.returncode and not failures:
        failures["the run"] = done.stdout.strip().rpartition("\n")[2]
    return Round(len(cases), failures, skipped)


@contextlib.contextmanager
def _load(processes: int) -> Iterator[None]:
    """Keep so many processes at work beside the tests."""
    with contextlib.ExitStack() as stack:
        for _ in range(processes):
            burner = stack.enter_context(
                subprocess.Popen(["nice", sys.executable, "-c", BURN])
            )
            stack.callback(burner.kill)
        yield


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("lasts", help="how long to begin rounds, such as 2h or 30min")
    parser.add_argument("tests", nargs="*", help="which tests; all when none is named")
    parser.add_argument(
        "--load", type=int, default=1, help="processes that use a CPU each (1)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the first order (1)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
