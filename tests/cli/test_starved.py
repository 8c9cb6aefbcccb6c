"""What a component needs is known although its computer does not give it that."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

import pytest

from poise.emulate import probe_host
from poise.estimate.online import Drift, Estimate
from poise.manage.journal import Journal
from poise.manage.observe.estimates import DemandEstimate, Estimates
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.session.launch.start import Sampling, started
from poise.wire.records.status_records import AgentSample

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
pytestmark = [pytest.mark.exhaustive, pytest.mark.slow]


JOBS, DEARER, COMMAND = "jobs", "dearer", "command"


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Seen]:
    """Run three components that get too little, until enough was seen of each.

    Each has a computer of its own, so they do not disturb each other.
    """
    if "cpu" not in probe_host().groups.controls:
        pytest.skip("no cgroup to write to with cpu")
    folder = tmp_path_factory.mktemp("starved")
    (folder / "starved_thinker.py").write_text(CODE)
    thinker = "starved_thinker:Thinker"
    components = (
        ComponentEntry(name=JOBS, implementation=thinker),
        ComponentEntry(name=DEARER, implementation=thinker, parameters={"calm": 8.0}),
        ComponentEntry(name=COMMAND, command=("sh", "-c", "while :; do :; done")),
    )
    capacity = {"cpu": QUOTA, "memory": 512 * 2.0**20}
    robot = Robot(
        name="starved",
        computers=tuple(
            Computer(name=f"of_{c.name}", capacity=capacity) for c in components
        ),
        architectures=(
            Architecture(name="think", function="think", components=components),
        ),
        folder=str(folder),
    )
    estimates = Estimates(robot, None, emulated=True)
    found = {c.name: Seen(c.name) for c in components}

    def take(sample: AgentSample) -> None:
        drifts = estimates.add(sample)
        for each in found.values():
            each.take(sample, drifts, estimates.demand_estimates())

    def is_enough() -> bool:
        return (
            found[JOBS].seconds > 7.0
            and len(found[DEARER].after()) >= 15
            and found[COMMAND].seconds > 3.0
        )

    placement = {c.name: f"of_{c.name}" for c in components}
    journal = Journal(":memory:")
    with started(robot, placement, journal, lambda _: None, Sampling(take)) as up:
        end = time.monotonic() + LIMIT
        while not is_enough():
            assert time.monotonic() < end, "they were not sampled"
            up.live.watch(0.2)
    journal.close()
    return found


class Seen:
    """What was told of one component: its CPU time, estimates, and drifts."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._used: list[tuple[float, float]] = []
        self.found: list[Estimate] = []
        self.drifts: list[Drift] = []

    def take(
        self,
        sample: AgentSample,
        drifts: Iterable[tuple[str, Drift]],
        estimates: Iterable[DemandEstimate],
    ) -> None:
        """Note what a sample of its computer tells."""
        if sample.computer != f"of_{self._name}":
            return
        self.drifts.extend(drift for name, drift in drifts if name == self._name)
        self.found.extend(
            each.estimate for each in estimates if each.component == self._name
        )
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

    def after(self) -> list[Estimate]:
        """Return the estimates since a drift was told."""
        return [each for each in self.found if each.drift is not None]


def test_jobs_that_went_undone_count(seen: Mapping[str, Seen]) -> None:
    """It gets half of what it needs, or less, and is told to need all.

    After 5 s the change detection has learned; that it is starved is no drift.
    """
    jobs = seen[JOBS]
    assert jobs.cores < 1.1 * QUOTA
    assert jobs.found[-1].mean == pytest.approx(NEEDED, rel=0.2)
    assert jobs.found[-1].starved > 0.35
    assert jobs.drifts == []


def test_what_it_needs_is_known_as_soon_as_it_is_dearer(
    seen: Mapping[str, Seen],
) -> None:
    """For 8 s it needs 3 % of a core, then twice what there is.

    Up to the 15th estimate after the shift was told, none is far too high; nor far too
    low, once a few jobs have ended.
    """
    for estimate in seen[DEARER].after()[:15]:
        assert estimate.mean < 1.3 * NEEDED
        assert estimate.error is None or estimate.mean > 0.7 * NEEDED
        assert estimate.starved > 0.3


def test_a_command_that_was_throttled_tells_a_lower_bound(
    seen: Mapping[str, Seen],
) -> None:
    burner = seen[COMMAND]
    assert burner.cores < 1.1 * QUOTA
    assert burner.found[-1].starved > 0.5
