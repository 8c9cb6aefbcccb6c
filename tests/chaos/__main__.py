"""Breaks a running robot at random for a while, and prints what came of it."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec

from poise.units import SECONDS, format_bytes, parse
from tests.chaos.chaos import Chaos

MOST_GROWTH = 1 << 20
"""No process may grow by more than this after its warm-up [bytes]."""


def main(argv: Sequence[str] | None = None) -> int:
    """Break the robot until the time is over; return 1 when it stayed broken."""
    told = _parser().parse_args(argv)

    def say(event: str) -> None:
        print(event, file=sys.stderr, flush=True)

    folder = told.folder or Path(tempfile.mkdtemp(prefix="poise-chaos-"))
    chaos = Chaos(folder, told.seed, say)
    with chaos.begun():
        chaos.go(parse(told.lasts, SECONDS))
    report = chaos.finish()
    if report.growth > MOST_GROWTH:
        report.trouble.append(f"{report.grew} grew by {format_bytes(report.growth)}")
    if told.json:
        print(json.dumps(msgspec.to_builtins(report), indent=2))
    else:
        print(report)
    print(f"journals, output and logs of handlers: {folder}", file=sys.stderr)
    return 1 if report.trouble else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("lasts", help="how long, such as 2min or 30min")
    parser.add_argument("--seed", type=int, default=1, help="of what happens when (1)")
    parser.add_argument("--folder", type=Path, help="gets journals and logs")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
