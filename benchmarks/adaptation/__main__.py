"""What adaptation gains under load, and what it costs.

``python -m benchmarks.adaptation [--quick] [--json] [--only overload|cpu|decision]``
``python -m benchmarks.adaptation --only overload --arm poise --seeds 1 --seconds 300``
``python -m benchmarks.adaptation --only alarms --seconds 600``

A robot of two emulated computers, with real processes, gets a background load on the
one where all of its components run. Its deadlines are counted with Poise's adaptation,
with none, and with random adaptation: that moves a random movable component to a random
other computer while a symptom lasts. All arms have the same loads, by seed.

`alarms` loads both computers to 95 %, and counts what Poise takes for a fault then.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

import msgspec

from benchmarks.adaptation import alarms, costs, overload

PARTS = ("overload", "cpu", "decision", "alarms")


def main() -> None:
    """Measure, and print it."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.adaptation", description=__doc__
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--quick", action="store_true", help="some two minutes")
    parser.add_argument("--only", choices=PARTS, help="one part")
    parser.add_argument("--seeds", type=int, help="of overload; 5, or 1 when quick")
    parser.add_argument("--arm", choices=overload.ARMS, help="of overload; else all")
    parser.add_argument("--seconds", type=float, help="of each load; 15, or 8")
    options = parser.parse_args()
    seeds = options.seeds or (1 if options.quick else 5)
    found: dict[str, Any] = {}
    if options.only in {None, "overload"}:
        seconds = options.seconds or (8.0 if options.quick else 15.0)
        arms = [options.arm] if options.arm else overload.ARMS
        trials = overload.compare(seeds, seconds, _say, arms)
        found["trials"] = trials
        found["overload"] = overload.summary(trials)
    if options.only in {None, "cpu"}:
        found["cpu"] = costs.cpu(5.0 if options.quick else 30.0)
    if options.only in {None, "decision"}:
        found["decision"] = costs.decision(5 if options.quick else 30)
    if options.only == "alarms":  # it takes minutes
        found["alarms"] = alarms.measure(options.seconds or 120.0, _say)
    if options.json:
        print(json.dumps(msgspec.to_builtins(found), indent=2))
        return
    for arm, each in found.get("overload", {}).items():
        print(
            f"{arm:8} missed {each.missed:6.1%} of deadlines, met again after "
            f"{each.met_again_s:4.1f} s, {each.moves:g} moves "
            f"(medians of {each.trials}); the last after {each.last_move_s:.1f} s"
        )
    if "alarms" in found:
        print(found["alarms"])
    for part in ("cpu", "decision"):
        for name, value in found.get(part, {}).items():
            print(f"{name:45} {value:.4f}")


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


if __name__ == "__main__":
    main()
