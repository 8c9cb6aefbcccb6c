"""A robot that is up changes its placement by itself."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import poise
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

WORK = '''
"""Works for a share of every tenth of a second."""

import time

from poise import Component, every


class Worker(Component):
    @every(0.1, deadline=0.1)
    def tick(self) -> None:
        end = time.thread_time() + 0.1 * float(self.parameters["share"])
        while time.thread_time() < end:
            pass
'''
ROBOT = """
robot: adapts
computers:
  left: {cpu: 0.5, memory: 1 GiB}
  right: {cpu: 0.5, memory: 1 GiB}
architectures:
  work:
    function: work
    home: left
    components:
      a: {implementation: "work:Worker", cpu: 20%, parameters: {share: 0.16}}
      b: {implementation: "work:Worker", cpu: 15%, parameters: {share: 0.12}}
      c:
        implementation: "work:Worker"
        cpu: 5%
        only: [left]
        parameters: {share: 0.01}
tasks:
  work: {actions: [{name: work, functions: [work]}]}
"""
HOG = [sys.executable, "-c", "while True: pass"]


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> poise.Robot:
    (tmp_path / "work.py").write_text(WORK)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    monkeypatch.chdir(tmp_path)
    return poise.load("robot.yaml")


def test_a_background_load_makes_components_move_away(robot: poise.Robot) -> None:
    said: list[str] = []
    placed = poise.place(robot, task="work", method="static")
    with poise.up(robot, task="work", placement=placed, say=said.append) as running:
        hog = running.emulated["left"].popen(HOG)
        wait_long(lambda: "right" in running.status().placement.values())
        wait_long(lambda: any("moved component" in each for each in said))
        hog.kill()
        placement = running.status().placement
    assert placement["c"] == "left"
    told = "\n".join(said)
    assert "is overloaded" in told or "deadlines within 1 s" in told
    assert "of work more, for" in told


def test_it_only_tells_when_it_may_not_adapt(robot: poise.Robot) -> None:
    placed = poise.place(robot, task="work", method="static")
    with poise.up(robot, task="work", placement=placed, adapt=False) as running:
        hog = running.emulated["left"].popen(HOG)
        wait_long(lambda: "left" in [d.computer for d in running.status().deviations])
        hog.kill()
        placement = running.status().placement
    assert set(placement.values()) == {"left"}
