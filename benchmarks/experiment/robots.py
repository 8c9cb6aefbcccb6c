"""The robots of the experiment, each with its task and the conditions it runs under.

It imports internal modules: it names what changes in a robot that runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

from benchmarks.experiment.results import BASE, LOADS, TrialCondition

SLOW_LINK = TrialCondition(name="link of 10 Mbit/s", bandwidth=10e6 / 8)
FULL_CPU = TrialCondition(name="98 % of the CPU is needed", fill=0.98)
_EXAMPLES = Path(__file__).parents[2] / "examples"


class ExperimentRobot(Struct, frozen=True, kw_only=True):
    """A robot, the task that each run is of, and all conditions; its own one first.

    The first three are the usual ones.
    """

    file: Path
    task: str
    conditions: tuple[TrialCondition, ...]


def _drift(computer: str) -> TrialCondition:
    """Return that another program takes more and more of a computer's CPU."""
    return TrialCondition(
        name=f"another program takes 0 to 30 % of {computer}",
        programs=tuple((start, computer, 0.1) for start in (0.2, 0.4, 0.6)),
    )


ROBOTS: Mapping[str, ExperimentRobot] = {
    "trot": ExperimentRobot(
        file=_EXAMPLES / "trot/robot.yaml",
        task="serve",
        conditions=(
            TrialCondition(name=BASE),
            FULL_CPU,
            TrialCondition(
                name="the localiser overruns by half",
                parameters={"localiser": {"particles": 10500}},
            ),
            _drift("main"),
            SLOW_LINK,
            *LOADS,
        ),
    ),
    "sorter": ExperimentRobot(
        file=_EXAMPLES / "sorter/robot.yaml",
        task="sort",
        conditions=(
            TrialCondition(name=BASE),
            FULL_CPU,
            TrialCondition(
                name="the inspector overruns by half",
                parameters={"inspector": {"directions": 12}},
            ),
            _drift("vision"),
            SLOW_LINK,
            *LOADS,
        ),
    ),
}
