"""Breaks a running robot at random for a while, and prints what came of it."""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec

from poise.units import SECONDS, format_bytes, format_seconds, parse
from tests.chaos.chaos import Chaos, ChaosReport

MOST_GROWTH = 1 << 20
"""No process may grow by more than this after its warm-up [bytes]."""


def main(argv: Sequence[str] | None = None) -> int:
    """Break the robot until the time is over; return 1 when it stayed broken."""
    told = _parser().parse_args(argv)
    began = time.monotonic()

    def say(event: str) -> None:
        print(f"{time.monotonic() - began:8.1f} s  {event}", file=sys.stderr)

    folder = Path(tempfile.mkdtemp(prefix="poise-chaos-"))
    chaos = Chaos(folder, random.Random(told.seed), say)
    with chaos.begun():
        chaos.go(parse(told.lasts, SECONDS))
    report = chaos.finish()
    if report.growth > MOST_GROWTH:
        report.trouble.append(f"{report.grew} grew by {format_bytes(report.growth)}")
    if told.json:
        print(json.dumps(msgspec.to_builtins(report), indent=2))
    else:
        print(summary(report))
    print(f"journal and output of the managers: {folder}", file=sys.stderr)
    return 1 if report.trouble else 0


def summary(report: ChaosReport) -> str:
    """Return a report as text."""

    def counts(*names: str) -> str:
        return ", ".join(f"{getattr(report, name)} {name}" for name in names)

    events = ", ".join(f"{n} x {what}" for what, n in report.events.most_common())
    settled = [format_seconds(value) for value in sorted(report.settled)]
    lines = [
        f"events: {events}",
        f"settled {len(settled)} times: {', '.join(settled)}",
        f"messages: {counts('received', 'lost', 'doubled', 'reordered')}",
        f"calls: {counts('answered', 'refused')}",
        f"memory: grown at most by {format_bytes(report.growth)}: {report.grew}",
        *(report.trouble or ["no trouble"]),
    ]
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("lasts", help="how long, such as 2min or 30min")
    parser.add_argument("--seed", type=int, default=1, help="of what happens when (1)")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
