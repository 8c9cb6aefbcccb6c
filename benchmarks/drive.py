"""Moves the localiser of the demo's robot while it drives, again and again.

It is the scene of `poise demo` alone; a drive takes about 15 s.

Usage: python -m benchmarks.drive [--json] [--times N]

It imports internal modules: it repeats a scene of the demo.
"""

from __future__ import annotations

import argparse
import io
import sys
from statistics import median

import msgspec
from msgspec import Struct
from rich.console import Console

from examples.demo.drives import Scene, load_trot, move_while_driving, told
from examples.demo.play import EXAMPLES


class Drives(Struct, frozen=True, kw_only=True):
    """What came of all drives; `missed` are deadlines amid the moves."""

    drives: int
    moved: int
    void: int
    missed: int
    downtime_median_s: float
    downtime_max_s: float
    prepared_median_s: float
    scenes: tuple[Scene, ...]


def main() -> None:
    """Drive, and print what came of it."""
    parser = argparse.ArgumentParser("python -m benchmarks.drive", description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--times", type=int, default=10)
    options = parser.parse_args()
    scenes = []
    robot = load_trot(EXAMPLES)
    for _ in range(options.times):
        silent = Console(file=io.StringIO())
        scenes.append(move_while_driving(robot, silent))
        phases = scenes[-1].move.phases.items()
        parts = ", ".join(f"{name} {1e3 * s:.1f}" for name, s in phases)
        void = f"; invalid: {scenes[-1].invalid}" if scenes[-1].invalid else ""
        sys.stderr.write(f"{told(scenes[-1])}{void}\n  [ms] {parts}\n")
    downtimes = [scene.move.downtime for scene in scenes]
    drives = Drives(
        drives=len(scenes),
        moved=sum(scene.move.committed for scene in scenes),
        void=sum(bool(scene.invalid) for scene in scenes),
        missed=sum(scene.during[0] for scene in scenes),
        downtime_median_s=median(downtimes),
        downtime_max_s=max(downtimes),
        prepared_median_s=median(scene.move.prepared for scene in scenes),
        scenes=tuple(scenes),
    )
    if options.json:
        sys.stdout.write(
            msgspec.json.format(msgspec.json.encode(drives)).decode() + "\n"
        )
        return
    for name in drives.__struct_fields__[:-1]:
        sys.stdout.write(f"{name:20} {getattr(drives, name)}\n")


if __name__ == "__main__":
    main()
