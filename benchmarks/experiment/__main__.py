"""Lets a robot work again and again: each way to place, each condition, many seeds.

Ctrl-C ends it, and the same command goes on. It takes about two hours, with --quick
five minutes, with --one half a minute, and writes a line for each run and a page.

Usage: python -m benchmarks.experiment [--robot trot | sorter] [--one | --quick |
--full] [--hours HOURS] [--folder FOLDER] [--json]

It imports internal modules: it measures runs from outside.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from rich.console import Console
from rich.markup import escape

import poise
from benchmarks.experiment.results import extents
from benchmarks.experiment.robots import ROBOTS
from benchmarks.experiment.series import PAGE, experiment
from benchmarks.experiment.tables import experiment_parts
from poise.cli.main import Interrupts
from poise.cli.options import print_json


def main() -> int:
    """Make the runs, and print what they show."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.experiment", description=__doc__
    )
    parser.add_argument("--robot", choices=ROBOTS, default="trot")
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--one", action="store_true", help="one run")
    extent.add_argument("--quick", action="store_true", help="four ways, two runs")
    extent.add_argument("--full", action="store_true", help="79 runs of each way")
    parser.add_argument(
        "--hours", type=float, default=math.inf, help="begin no run after this time"
    )
    parser.add_argument(
        "--folder", type=Path, help="for results; else poise-experiment-ROBOT"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    tried = ROBOTS[options.robot]
    folder = options.folder or Path(f"poise-experiment-{options.robot}")
    console = Console(stderr=options.json, highlight=False)

    def say(sentence: str) -> None:
        console.print(escape(sentence), soft_wrap=True)

    robot = poise.load(tried.file, say=say)
    flags = (flag for flag in ("one", "quick", "full") if getattr(options, flag))
    chosen = extents(tried.conditions)[next(flags, "usual")]
    with Interrupts() as interrupts:
        try:
            report = experiment(
                robot,
                tried.task,
                chosen,
                folder,
                hours=options.hours,
                say=say,
                check=interrupts.check,
            )
        finally:
            say(f"the page of all runs so far is {(folder / PAGE).absolute()}")
            if interrupts.has_come():
                say("the same command goes on from here")
    if options.json:
        print_json(report)
    else:
        console.print(*experiment_parts(report), sep="\n")
    if silent := [each for each in report.arms if each.runs == each.invalid]:
        what = ", ".join(f"{each.placement} ({each.condition})" for each in silent)
        console.print(f"no valid run of {what}", soft_wrap=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
