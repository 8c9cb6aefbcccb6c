"""Stands for the engine: virtual time passes, and a report says what was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.simulation.rehearsal import RehearsalPlan
from poise.simulation.simulation_report import (
    Outage,
    SimulatedChain,
    SimulatedEvent,
    SimulatedLoad,
    SimulatedMove,
    SimulationReport,
    TimerMisses,
)

HELLO = Path(__file__).parents[2] / "examples/hello/robot.yaml"


def timer(
    name: str, due: int, missed: int, deadline: float | None = 0.1
) -> TimerMisses:
    return TimerMisses(
        component=name,
        timer="tick",
        period=0.1,
        deadline=deadline,
        due=due,
        missed=missed,
    )


REPORT = SimulationReport(
    robot="hello",
    task="greet",
    method="auto",
    seed=7,
    adapts=True,
    placement={"counter": "left", "printer": "right"},
    asked=3600.0,
    seconds=3600.0,
    took=48.0,
    loads=(
        SimulatedLoad(
            computer="left",
            capacity=0.5,
            cpu=0.25,
            peak=0.75,
            memory=2.0**20,
            memory_capacity=2.0**30,
            over_time=((1.0, 0.2), (2.0, 0.75)),
        ),
        SimulatedLoad(
            computer="right",
            capacity=None,
            cpu=0.5,
            peak=1.0,
            memory=2.0**20,
            memory_capacity=None,
        ),
    ),
    timers=(
        timer("printer", 1000, 5),
        timer("counter", 1000, 20),
        timer("b", 9, 9, None),
    ),
    chains=(
        SimulatedChain(
            name="hello",
            deadline=0.2,
            uses=100,
            missed=25,
            median=0.12,
            p99=0.3,
            maximum=0.4,
        ),
    ),
    moves=(
        SimulatedMove(
            at=605.0,
            component="printer",
            before="right",
            after="left",
            kind="restart",
            downtime=1.5,
            why="'right' is lost",
        ),
    ),
    outages=(
        Outage(at=600.0, function="greeting", components=("printer",), lasts=6.5),
    ),
    events=(
        SimulatedEvent(
            at=600.0, who="fault", kind="isolate computer", what="right <cut>"
        ),
        SimulatedEvent(at=604.0, who="left", kind="lost", what="'right' is lost"),
    ),
    messages=36000,
    dropped=3,
    calls=0,
    failed_calls=0,
    guesses=("printer: CPU 5%, as the robot file says",),
)


class FakeRehearsal:
    """Lets time pass at once; what it was asked for and did is kept in the class."""

    plans: list[RehearsalPlan]
    seeds: list[int]
    closed: int
    fails: str
    """The method whose robot does not come up."""
    violations: tuple[str, ...]

    def __init__(self, scenario: RehearsalPlan, seed: int = 0) -> None:
        self.now = 0.0
        self._plan = scenario
        self.plans.append(scenario)
        self.seeds.append(seed)

    def come_up(self) -> None:
        if self._plan.method == self.fails:
            raise RunError("'printer' did not come up")

    def advance(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds

    def report(self) -> SimulationReport:
        return replace(
            REPORT,
            method=self._plan.method,
            seed=self.seeds[-1],
            adapts=self._plan.adapts,
            placement=self._plan.placement,
            asked=self._plan.seconds,
            seconds=self.now,
            violations=self.violations,
        )

    def close(self) -> None:
        type(self).closed += 1


@pytest.fixture
def rehearsal(monkeypatch: pytest.MonkeyPatch) -> type[FakeRehearsal]:
    """Let the fake simulate; return it."""
    for name in ("plans", "seeds"):
        monkeypatch.setattr(FakeRehearsal, name, [], raising=False)
    for name, value in (("closed", 0), ("fails", ""), ("violations", ())):
        monkeypatch.setattr(FakeRehearsal, name, value, raising=False)
    monkeypatch.setattr("poise.simulation.rehearsal.Rehearsal", FakeRehearsal)
    return FakeRehearsal
