"""What a component needs is known although its computer does not give it that."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from poise.emulate import look
from poise.estimate.online import Drift, Estimate
from poise.manage.journal import Journal
from poise.manage.observe.estimates import Estimates
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.session.launch.start import Sampling, started
from poise.wire.records.samples import AgentSample

QUOTA = 0.3
NEEDED = 0.6
CODE = f"""
import time
from poise import Component, every

class Thinker(Component):
    def activate(self) -> None:
        self._dearer_at = self.clock.now() + float(self.parameters.get("calm", 0.0))

    @every(0.05)
    def think(self) -> None:
        needed = {NEEDED} if self.clock.now() >= self._dearer_at else {NEEDED} / 20
        end = time.thread_time() + 0.05 * needed
        while time.thread_time() < end:
            pass
"""
LIMIT = 60.0


@pytest.fixture(autouse=True)
def quota() -> None:
    """Skip where this user may not limit processes."""
    if "cpu" not in look().groups.controls:
        pytest.skip("no cgroup to write to with cpu")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "starved_thinker.py").write_text(CODE)
    return tmp_path


def starved(
    component: ComponentEntry, folder: Path, enough: Callable[[Seen], bool]
) -> Seen:
    """Run a component until enough was seen of it."""
    robot = Robot(
        name="starved",
        computers=(
            Computer(name="small", capacity={"cpu": QUOTA, "memory": 512 * 2.0**20}),
        ),
        architectures=(
            Architecture(name="think", function="think", components=(component,)),
        ),
        folder=str(folder),
    )
    seen = Seen(Estimates(robot, None, emulated=True))
    journal = Journal(":memory:")
    with started(
        robot, {component.name: "small"}, journal, lambda _: None, Sampling(seen.take)
    ) as up:
        end = time.monotonic() + LIMIT
        while not enough(seen):
            assert time.monotonic() < end, "it was not sampled"
            up.run.watch(0.2)
    journal.close()
    return seen


class Seen:
    """What was told of one component: its CPU time, estimates, and drifts."""

    def __init__(self, estimates: Estimates) -> None:
        self._estimates = estimates
        self._used: list[tuple[float, float]] = []
        self.found: list[Estimate] = []
        self.drifts: list[Drift] = []

    def take(self, sample: AgentSample) -> None:
        """Estimate."""
        self.drifts.extend(drift for _, drift in self._estimates.take(sample))
        self.found.extend(each.estimate for each in self._estimates.demand_estimates())
        self._used.extend(
            (container.at, each.cpu)
            for container in sample.containers
            for each in container.components
            if each.cpu > 0.1  # it is at work
        )

    @property
    def seconds(self) -> float:
        """How long it was seen at work [s]."""
        return self._used[-1][0] - self._used[0][0] if self._used else 0.0

    @property
    def cores(self) -> float:
        """What it used meanwhile."""
        return (self._used[-1][1] - self._used[0][1]) / self.seconds


@pytest.mark.slow
def test_jobs_that_went_undone_count(folder: Path) -> None:
    """It gets half of what it needs, or less, and is told to need all.

    After 5 s the change detection has learned; that it is starved is no drift.
    """
    thinker = ComponentEntry(name="thinker", implementation="starved_thinker:Thinker")
    seen = starved(thinker, folder, lambda seen: seen.seconds > 7.0)
    assert seen.cores < 1.1 * QUOTA
    assert seen.found[-1].mean == pytest.approx(NEEDED, rel=0.2)
    assert seen.found[-1].starved > 0.35
    assert seen.drifts == []


@pytest.mark.slow
def test_what_it_needs_is_known_as_soon_as_it_is_dearer(folder: Path) -> None:
    """For 8 s it needs 3 % of a core, then twice what there is.

    Up to the 15th estimate after the shift was told, none is far too high; nor far too
    low, once a few jobs have ended.
    """
    thinker = ComponentEntry(
        name="thinker",
        implementation="starved_thinker:Thinker",
        parameters={"calm": 8.0},
    )
    seen = starved(thinker, folder, lambda seen: len(after(seen)) >= 15)
    for estimate in after(seen):
        assert estimate.mean < 1.3 * NEEDED
        assert estimate.error is None or estimate.mean > 0.7 * NEEDED
        assert estimate.starved > 0.3


def after(seen: Seen) -> list[Estimate]:
    """Return the estimates since a drift was told."""
    return [each for each in seen.found if each.drift is not None]


@pytest.mark.slow
def test_a_command_that_was_throttled_tells_a_lower_bound(folder: Path) -> None:
    burner = ComponentEntry(name="burner", command=("sh", "-c", "while :; do :; done"))
    seen = starved(burner, folder, lambda seen: seen.seconds > 3.0)
    assert seen.cores < 1.1 * QUOTA
    assert seen.found[-1].starved > 0.5
