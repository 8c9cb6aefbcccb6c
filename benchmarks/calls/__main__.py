"""``python -m benchmarks.calls [--json] [--quick]``: what calls and messages cost."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from statistics import median

from benchmarks.calls.cases import ALL, CASES
from benchmarks.calls.pair import Row, run
from benchmarks.calls.timing import Times

COUNTS = {64: 5000, 4096: 2000, 1 << 20: 300, 6 << 20: 100}
PACKAGES = ("eclipse-zenoh", "pyzmq", "iceoryx2", "ros-rclpy", "msgspec", "numpy")
NAMES = {64: "64 B", 4096: "4 KB", 1 << 20: "1 MB", 6 << 20: "6 MB"}


def machine() -> dict[str, str]:
    """Return what the numbers depend on."""
    found = {"cpus": str(os.cpu_count()), "kernel": platform.release()}
    with open("/proc/cpuinfo") as file:  # noqa: PTH123, a file of the kernel
        models = [line.split(":")[1].strip() for line in file if "model name" in line]
    found["cpu"] = models[0] if models else platform.machine()
    found["python"] = platform.python_version()
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def table(rows: list[Row]) -> str:
    """Return the rows as text: median / 99th percentile of the round trip."""
    lines = [_line("round trip [us]: median/p99", [NAMES[s] for s in ALL], "idle CPU")]
    for row in rows:
        cells = {t.size: f"{_short(t.median_us)}/{_short(t.p99_us)}" for t in row.times}
        idle = row.remark or f"{row.idle:.2%}"
        lines.append(_line(row.title, [cells.get(size, "") for size in ALL], idle))
    return "\n".join(lines)


def as_json(rows: list[Row]) -> str:
    """Return everything, and the medians at 64 B [us] by name."""
    found: dict[str, object] = {
        row.key: row.times[0].median_us for row in rows if row.key and row.times
    }
    found["machine"] = machine()
    found["rows"] = [
        {
            "title": row.title,
            "idle_cores": row.idle,
            "remark": row.remark,
            "times": {NAMES[t.size]: [t.median_us, t.p99_us] for t in row.times},
        }
        for row in rows
    ]
    return json.dumps(found, indent=2)


def main() -> None:
    """Measure all cases, one after the other, in so many rounds as are wanted."""
    parser = argparse.ArgumentParser("python -m benchmarks.calls", description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="fewer round trips")
    parser.add_argument("--only", nargs="*", default=[""], help="parts of titles")
    parser.add_argument(
        "--rounds", type=int, default=1, help="medians over so many rounds of all cases"
    )
    options = parser.parse_args()
    share = 0.2 if options.quick else 1.0
    counts = {size: int(count * share) for size, count in COUNTS.items()}
    cases = [c for c in CASES if any(part in c.title for part in options.only)]
    rounds = []
    for number in range(options.rounds):
        print("round", number + 1, "...", file=sys.stderr)
        rounds.append([run(case, counts) for case in cases])
    rows = [_middle(rows) for rows in zip(*rounds, strict=True)]
    print(as_json(rows) if options.json else table(rows))


def _middle(rows: tuple[Row, ...]) -> Row:
    """Return the medians of a case's rounds."""

    def middle(times: tuple[Times, ...]) -> Times:
        medians, p99s = zip(*((t.median_us, t.p99_us) for t in times), strict=True)
        return Times(times[0].size, round(median(medians), 3), round(median(p99s), 3))

    by_size = zip(*(row.times for row in rows), strict=True)
    return Row(
        title=rows[0].title,
        key=rows[0].key,
        times=tuple(middle(times) for times in by_size),
        idle=max(row.idle for row in rows),
        remark=rows[0].remark,
    )


def _short(microseconds: float) -> str:
    return f"{microseconds:.3g}" if microseconds < 100 else f"{microseconds:,.0f}"


def _line(title: str, cells: list[str], last: str) -> str:
    return f"{title:28}" + "".join(f"{cell:>16}" for cell in cells) + f"  {last}"


if __name__ == "__main__":
    main()
