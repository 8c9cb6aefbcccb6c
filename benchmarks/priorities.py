"""What priorities are worth on an overloaded computer.

Two architectures want 0.3 and 0.4 cores of a computer that has 0.5. Both have the same
priority, or one has 10 and the other 1; the two runs alternate.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import textwrap
from collections.abc import Mapping
from pathlib import Path

import poise

CODE = """
import time
from poise import Component, every

class Worker(Component):
    def configure(self) -> None:
        self.work = self.parameters["work"]

    @every(0.05, deadline=0.05)
    def step(self) -> None:
        end = time.thread_time() + self.work
        while time.thread_time() < end:
            pass
"""
# the file says less than they want, as a robot does that was never measured
ROBOT = """
robot: {name}
computers: {{only: {{cpu: 0.5, memory: 1 GiB}}}}
architectures:
  important:
    function: important
    priority: {priority}
    components:
      important:
        implementation: "worker:Worker"
        cpu: 10%
        parameters: {{work: {work[0]}}}
  other:
    function: other
    priority: 1
    components:
      other:
        implementation: "worker:Worker"
        cpu: 10%
        parameters: {{work: {work[1]}}}
tasks: {{both: {{actions: [{{name: both, functions: [important, other]}}]}}}}
"""


def run(
    priority: int,
    seconds: float,
    folder: Path,
    work: tuple[float, float] = (0.015, 0.020),
) -> poise.RunReport:
    """Run both, of which the important one has a priority.

    Parameters
    ----------
    work
        What a step of the important one and of the other one takes [s of a core].
    """
    (folder / "worker.py").write_text(CODE, encoding="utf-8")
    file = folder / f"priority{priority}.yaml"
    text = ROBOT.format(name=f"priority{priority}", priority=priority, work=work)
    file.write_text(textwrap.dedent(text), encoding="utf-8")
    return poise.run(poise.load(file), seconds=seconds)


def deadlines_met(report: poise.RunReport) -> Mapping[str, float]:
    """Return component -> the share of its deadlines that it met."""
    return {
        component.name: 1 - timer.missed / timer.releases
        for component in report.components
        for timer in component.timers
    }


def main() -> None:
    """Print the shares with and without priorities."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.priorities", description=__doc__
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    met: dict[tuple[int, str], list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(options.rounds):
            for priority in (1, 10):
                shares = deadlines_met(run(priority, options.seconds, Path(folder)))
                for name, share in shares.items():
                    met.setdefault((priority, name), []).append(share)
    print("| priorities | component | deadlines met (median, least) |")
    print("| --- | --- | --- |")
    for (priority, name), shares_of in sorted(met.items()):
        least, median = min(shares_of), statistics.median(shares_of)
        print(f"| {priority} and 1 | {name} | {median:.1%}, {least:.1%} |")


if __name__ == "__main__":
    main()
