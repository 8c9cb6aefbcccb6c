"""Breaks a random computer of a robot again and again, that of its leader included.

    python -m tests.leader_kills 200            # so many kills
    python -m tests.leader_kills 20 --seed 7
    python -m tests.leader_kills 20 --witness   # of two computers, and one that votes
    python -m tests.leader_kills 20 --faults cut,flap

Each computer is emulated in a network namespace of its own, which needs root. Tickers
note each tick with the time of the machine's one clock, so the counts are the test's
own. The exit code is 1 when something ticked twice, stayed away or was forgotten.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
from pathlib import Path

from tests.leader_kills.kills import FAULTS, NAMES, Kills, Report


def main() -> int:
    """Run what the command line asks for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kills", nargs="?", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--witness", action="store_true")
    parser.add_argument("--faults", default="kill", help=f"of {', '.join(FAULTS)}")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder}
        return _run(Path(folder), asked)


def _run(folder: Path, asked: argparse.Namespace) -> int:
    faults = asked.faults.split(",")
    with Kills(folder, with_witness=asked.witness) as kills:
        chance = random.Random(asked.seed)
        for _ in range(asked.kills):
            computer, back_after = chance.choice(NAMES), chance.random()
            fault = chance.choice(faults)
            print(kills.kill(computer, back_after, fault), flush=True)
    report = Report.of(kills)
    print(json.dumps(report.figures(), indent=2))
    return bool(report.broken())


if __name__ == "__main__":
    sys.exit(main())
