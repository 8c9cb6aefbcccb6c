"""A small experiment with real processes: a run that breaks, and going on."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from benchmarks.experiment.analysis import voided
from benchmarks.experiment.measure import measure
from benchmarks.experiment.results import (
    ARMS,
    BASE,
    Extent,
    TrialCondition,
    named,
    read,
)
from benchmarks.experiment.series import PAGE, RAW, experiment
from benchmarks.experiment.summary import ArmSummary
from poise.session import nothing
from tests.session.emulated_robot import written
from tests.waiting import LONG

OWN = TrialCondition(name=BASE)
WORK = """
from poise import Component, Published, every


class Worker(Component):
    counted: Published[bool]

    def configure(self) -> None:
        self._count = 0

    @every(0.05, deadline=0.05)
    def tick(self) -> None:
        self._count += 1
        if self._count == 20:
            self.counted.publish(True)
"""
WORLD = '''
"""A world that dies in seed 1 while the file `deadly` is there."""

import json
import pathlib
import signal
import sys

signal.signal(signal.SIGTERM, signal.SIG_IGN)  # its input ends as well

print("ready", flush=True)
if "1" in sys.argv and pathlib.Path("deadly").exists():
    sys.exit("the world fell apart")
sys.stdin.read()
print(json.dumps({"functions": {"work": True}, "path": [1, 2], "path_error": 0.5}))
'''
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 0.2, memory: 512 MiB}}
  right: {{cpu: 0.2, memory: 512 MiB}}
architectures:
  work:
    function: work
    home: left
    components:
      a: {{implementation: "tried_work:Worker", cpu: 5%}}
      b: {{implementation: "tried_work:Worker", cpu: 5%}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
  count: {{actions: [{{name: count, functions: [work], ends: a.counted}}]}}
simulator: {{command: "python {folder}/world.py"}}
"""


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.timeout(LONG)
def test_a_run_whose_world_died_is_made_again(tmp_path: Path) -> None:
    (tmp_path / "world.py").write_text(WORLD)
    (tmp_path / "deadly").touch()
    robot = poise.load(written(tmp_path, "tried", "tried_work", WORK, ROBOT))
    extent = Extent(
        arms=(named(ARMS, "Poise, adapts"),), conditions=(OWN,), base_seeds=2
    )
    folder, said = tmp_path / "results", list[str]()

    def make() -> ArmSummary:
        report = experiment(
            robot, "work", extent, folder, seconds=0.5, say=said.append, check=nothing
        )
        (arm,) = report.arms
        return arm

    arm = make()
    assert arm.runs == 2
    assert arm.invalid >= 1, said
    broken = read(folder / RAW)[1]
    assert "the simulated world ended after" in broken.invalid
    assert "2 of 2" in said[-1]

    (tmp_path / "deadly").unlink()
    # a machine whose speed changed makes runs invalid, too
    before = {each.trial for each in voided(read(folder / RAW)) if not each.invalid}
    arm = make()
    results = read(folder / RAW)
    assert not before & {each.trial for each in results[2:]}
    valid = [each for each in voided(results) if not each.invalid]
    assert arm.success["work"].of == len(valid)
    measured = [each for each in results if each.seconds]  # valid or not
    assert measured
    for each in measured:
        assert each.functions == {"work": True}
        assert each.world == {"path_error": 0.5}
        assert each.timers.keys() == {"a.tick", "b.tick"}
        assert each.cpu_share.keys() == {"left", "right"}
        assert each.placement.keys() == {"a", "b"}
    assert f"{len(valid)} valid runs of 2" in (folder / PAGE).read_text()


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.timeout(LONG)
def test_a_run_ends_with_its_task(tmp_path: Path) -> None:
    """What a robot does not do afterwards is nobody's failure."""
    (tmp_path / "world.py").write_text(WORLD)
    text = ROBOT.replace("tried_work", "counted_work")
    robot = poise.load(written(tmp_path, "counted", "counted_work", WORK, text))
    arm = named(ARMS, "Poise")
    result = measure(robot, "count", arm, OWN, 0, LONG, nothing)
    assert 0 < result.seconds < LONG / 2
    assert result.functions == {"work": True}
