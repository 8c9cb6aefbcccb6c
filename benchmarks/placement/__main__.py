"""Run the placement benchmarks, all methods side by side in one run.

python -m benchmarks.placement [--quick] [--gqap FOLDER] [--json FILE] [--plot FILE]

``quality`` holds short runs against long ones, which take over a minute a robot. They
are kept in the folder of ``--references``, so that a run that was ended goes on where
it was.

The folder of ``--gqap`` holds public instances of the generalised quadratic assignment
problem in the format of Cordeau, Gaudioso, Laporte and Moccia (INFORMS Journal on
Computing 18(4), 2006), with their best known values in ``best_known.json``.
"""

from __future__ import annotations

import argparse
import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.placement import (
    growth,
    plot,
    proof,
    public,
    quality,
    speed,
    tight,
)


def main() -> None:
    arguments = _arguments()
    quick = arguments.quick
    report: dict[str, Any] = {"machine": machine()}
    print(f"{report['machine']}\n")
    for name, section in (
        ("speed", speed.run),
        ("proof", proof.run),
        ("tight", tight.run),
        ("growth", growth.run),
    ):
        if arguments.only and name not in arguments.only.split(","):
            continue
        report[name] = section(quick=quick)
    if "quality" in (arguments.only or "quality").split(","):
        robots = arguments.robots or (3 if quick else 10)
        report["quality"] = quality.run(robots, Path(arguments.references))
    if arguments.gqap:
        report["public"] = public.run(Path(arguments.gqap), quick=quick)
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(report, indent=1), encoding="utf-8")
    if arguments.plot and "growth" in report:
        plot.growth(report["growth"], Path(arguments.plot))


def machine() -> str:
    """Return what the numbers were measured with."""
    names = [
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        if line.startswith("model name")
    ]
    processor = f"{names[0]}, {len(names)} cores" if names else platform.processor()
    return (
        f"{processor}; {platform.system()} {platform.release()}; "
        f"Python {platform.python_version()}; poise {version('poise')}"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer and smaller")
    parser.add_argument(
        "--only",
        help="sections: speed,proof,quality,tight,growth",
    )
    parser.add_argument(
        "--references",
        default=Path.home() / ".cache" / "poise-benchmarks",
        help="folder that keeps the long runs of `quality`",
    )
    parser.add_argument("--robots", type=int, help="of `quality`, for each row")
    parser.add_argument("--gqap", help="folder of public instances")
    parser.add_argument("--json", help="write all numbers to this file")
    parser.add_argument("--plot", help="write the plot of growth to this SVG file")
    return parser.parse_args()


if __name__ == "__main__":
    main()
