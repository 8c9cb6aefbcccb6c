"""The robot file and its profile: placement decides whether it works."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from msgspec.structs import replace

import poise
from poise.estimate import profiles as profile_file
from poise.estimate.demands import with_profile
from poise.model import load
from tests.sorter.loop import EXAMPLE, LESSER

FILE = EXAMPLE / "robot.yaml"
PROFILE = profile_file.read(Path(EXAMPLE / "profile.yaml"))
ROBOT = with_profile(load(FILE), PROFILE)
COARSE = {"coarse_detection", "coarse_inspection"}
USABLE = {c.name: 0.95 * c.capacity["cpu"] * c.speed for c in ROBOT.computers}
NEEDS = {each.name: each.demand["cpu"] for each in ROBOT.components()}


def test_every_component_is_profiled() -> None:
    assert NEEDS.keys() == PROFILE.components.keys()
    assert len(NEEDS.keys() - LESSER) == 10


def test_fills_three_computers_to_nine_tenths() -> None:
    needed = sum(cpu for name, cpu in NEEDS.items() if name not in LESSER)
    assert 0.85 < needed / sum(USABLE.values()) < 0.95


def test_the_lesser_alternatives_need_less() -> None:
    assert NEEDS["small_detector"] < 0.5 * NEEDS["detector"]
    assert NEEDS["quick_inspector"] < 0.6 * NEEDS["inspector"]


def test_each_function_at_home_overloads_a_computer() -> None:
    at_home = sum(
        component.demand["cpu"]
        for each in ROBOT.architectures
        if each.home == "vision" and each.name not in COARSE
        for component in each.components
    )
    assert at_home > 1.2 * USABLE["vision"]


def test_several_placements_keep_the_limits_of_cpu() -> None:
    """The free components may be anywhere: 3^5 placements; README counts them."""
    at = {each.name: each.computer for each in ROBOT.devices}
    pinned = {
        each.name: at[each.devices[0]] for each in ROBOT.components() if each.devices
    }
    free = sorted(NEEDS.keys() - pinned.keys() - LESSER)
    kept = 0
    for where in product(USABLE, repeat=len(free)):
        used = dict.fromkeys(USABLE, 0.0)
        for name, computer in (*pinned.items(), *zip(free, where, strict=True)):
            used[computer] += NEEDS[name]
        kept += all(used[name] <= USABLE[name] for name in USABLE)
    assert (len(free), kept) == (5, 50)


def test_all_fits_by_cpu() -> None:
    placed = poise.place(replace(ROBOT, chains=()), "sort")
    assert not COARSE & set(placed.architectures.values())
    assert set(placed.where.values()) == {"arm", "vision", "cell"}


@pytest.mark.slow
def test_with_the_lesser_alternatives_the_timers_of_the_arm_are_in_time() -> None:
    placed = poise.place(ROBOT, "sort")
    assert COARSE & set(placed.architectures.values())
    for times in placed.predicted.values():
        assert all(timer.p99 < timer.deadline for timer in times.timers)


@pytest.mark.slow
def test_no_method_finds_less_than_the_best_one() -> None:
    best, greedy = (poise.place(ROBOT, "sort", method=m) for m in ("auto", "greedy"))
    assert best.task_result.total is not None
    assert greedy.task_result.total is not None
    assert best.task_result.total <= greedy.task_result.total


@pytest.mark.slow
def test_what_is_late_counts_also_where_something_is_suspended() -> None:
    slow = tuple(replace(computer, speed=0.13) for computer in ROBOT.computers)
    robot = replace(ROBOT, computers=slow)
    placed = poise.place(robot, "sort", method="greedy", fewer=True)
    assert placed.result.suspended
    assert any(t.late for each in placed.predicted.values() for t in each.timers)
    assert placed.result.objective is not None
    assert placed.result.objective.time > 1.0
