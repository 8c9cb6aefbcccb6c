"""What faults do to a robot that a user rehearses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from poise.model.load import load
from poise.simulation.faults import SimulatedFault
from poise.simulation.rehearsal import Rehearsal, RehearsalPlan
from poise.simulation.report import SimulationReport

HELLO = Path(__file__).parents[2] / "examples/hello/robot.yaml"


@contextmanager
def rehearsed(fault: SimulatedFault, seconds: float) -> Iterator[SimulationReport]:
    """Give what comes of a fault: the counter is on the left, the printer right."""
    plan = RehearsalPlan(
        robot=load(HELLO),
        placement={"counter": "left", "printer": "right"},
        method="auto",
        tasks=("greet",),
        faults=(fault,),
        seconds=seconds,
    )
    with closing(Rehearsal(plan)) as rehearsal:
        rehearsal.come_up()
        rehearsal.advance(seconds)
        yield rehearsal.report()


@pytest.mark.slow
def test_what_is_killed_misses_no_deadlines_afterwards() -> None:
    """10 Hz for 5 s, of which a restart takes a little."""
    with rehearsed(SimulatedFault(1.0, "kill container", "left"), 5.0) as report:
        (timer,) = report.timers
        assert 40 <= timer.due <= 50
        assert timer.missed <= 5
