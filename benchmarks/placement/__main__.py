"""Measure the planner through its public API.

python -m benchmarks.placement [--quick] [--only SECTIONS] [--json [FILE]]

Sections: speed (one decision), proof (against CP-SAT), tight (robots that are nearly
full), fleets (1,000 components and more), phases (of a task, against CP-SAT).
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from pathlib import Path
from typing import Any

from benchmarks.placement import fleets, phases, proof, speed, tight

SECTIONS = {
    "speed": speed.run,
    "proof": proof.run,
    "tight": tight.run,
    "fleets": fleets.run,
    "phases": phases.run,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m benchmarks.placement",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="fewer and smaller")
    parser.add_argument("--only", help="sections, such as speed,fleets")
    parser.add_argument(
        "--json", nargs="?", const="-", help="write the numbers to FILE, or to stdout"
    )
    arguments = parser.parse_args()
    wanted = arguments.only.split(",") if arguments.only else list(SECTIONS)
    if unknown := {*wanted} - {*SECTIONS}:
        parser.error(
            f"no section {', '.join(unknown)} (there are: {', '.join(SECTIONS)})"
        )
    report: dict[str, Any] = {"machine": f"{platform.machine()}, {platform.platform()}"}
    for name in wanted:
        found = SECTIONS[name](quick=arguments.quick)
        report |= found if isinstance(found, dict) else {name: found}
    text = json.dumps(report, indent=1) + "\n"
    if arguments.json == "-":
        sys.stdout.write(text)
    elif arguments.json:
        Path(arguments.json).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
