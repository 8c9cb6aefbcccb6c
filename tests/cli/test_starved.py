"""What a component needs is known although its computer does not give it that."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from poise.cli.launch import Watching, running
from poise.emulate import look
from poise.manage.estimates import Estimates, Standing
from poise.manage.journal import Journal
from poise.model.robot import Architecture, Component, Computer, Robot
from poise.wire.samples import AgentSample

QUOTA = 0.3
NEEDED = 0.6
CODE = f"""
import time
from poise import Component, every

class Thinker(Component):
    @every(0.05)
    def think(self) -> None:
        end = time.thread_time() + 0.05 * {NEEDED}
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
    component: Component, folder: Path, seconds: float
) -> tuple[Standing, float, int]:
    """Run a component; return how it stands, its CPU time a second, and its drifts.

    `seconds` long the estimate has seen it.
    """
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
    estimates = Estimates(robot, None, emulated=True)
    told: list[tuple[float, float]] = []
    drifts: list[object] = []

    def take(sample: AgentSample) -> None:
        drifts.extend(estimates.take(sample))
        told.extend(
            (container.at, each.cpu)
            for container in sample.containers
            for each in container.components
            if each.cpu > 0.1  # it is at work
        )

    journal = Journal(":memory:")
    with running(
        robot, {component.name: "small"}, journal, lambda _: None, Watching(take)
    ) as up:
        end = time.monotonic() + LIMIT
        while not told or told[-1][0] - told[0][0] < seconds:
            assert time.monotonic() < end, "it was not sampled"
            up.run.watch(0.2)
    journal.close()
    (began, before), (ended, after) = told[0], told[-1]
    (standing,) = estimates.standings()
    return standing, (after - before) / (ended - began), len(drifts)


@pytest.mark.slow
def test_jobs_that_went_undone_count(folder: Path) -> None:
    """It gets half of what it needs, or less, and is told to need all.

    After 5 s the change detection has learned; that it is starved is no drift.
    """
    thinker = Component(name="thinker", implementation="starved_thinker:Thinker")
    standing, used, drifts = starved(thinker, folder, 7.0)
    assert used < 1.1 * QUOTA
    assert standing.estimate.mean == pytest.approx(NEEDED, rel=0.2)
    assert standing.estimate.starved > 0.35
    assert drifts == 0


@pytest.mark.slow
def test_a_command_that_was_throttled_tells_a_lower_bound(folder: Path) -> None:
    burner = Component(name="burner", command=("sh", "-c", "while :; do :; done"))
    standing, used, _ = starved(burner, folder, 3.0)
    assert used < 1.1 * QUOTA
    assert standing.estimate.starved > 0.8
