"""The robot file and its profile, as the case study has them."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

import poise
from poise.estimate import profiles as profile_file
from poise.estimate.demands import with_profile
from poise.model import load

FILE = Path(__file__).parents[2] / "examples" / "trot" / "robot.yaml"
PROFILE = profile_file.read(FILE.with_name("profile.yaml"))
ROBOT = with_profile(load(FILE), PROFILE)
VISION = {"head_turner", "face_recogniser"}
"""They need devices of `vision`."""
LESSER = {"small_localiser", "near_face_recognition"}
"""Alternatives with less quality."""


def test_has_the_components_of_the_case_study() -> None:
    counts = {each.name: len(each.components) for each in ROBOT.architectures}
    assert counts.pop("navigator") + counts.pop("particle_localiser") == 5
    assert counts == {
        "recommender": 4,
        "arm_manipulator": 4,
        "interaction_manager": 7,
        "audition_planner": 4,
        "face_recognition": 1,
        **dict.fromkeys(LESSER, 1),
    }


def test_every_component_is_profiled() -> None:
    names = {component.name for component in ROBOT.components()}
    assert names == PROFILE.components.keys()


def test_overloads_one_computer_and_fits_on_two() -> None:
    """What may be on `main` needs more than it has; all needs less than both have."""
    has = {c.name: c.capacity["cpu"] * c.speed for c in ROBOT.computers}
    assert has == {"main": 0.32, "vision": 0.32}
    needs = {
        component.name: component.demand["cpu"]
        for architecture in ROBOT.architectures
        if architecture.name not in LESSER
        for component in architecture.components
    }
    assert sum(cpu for name, cpu in needs.items() if name not in VISION) > 1.2 * 0.32
    assert sum(needs.values()) < 0.95 * 2 * 0.32


def test_the_lesser_alternatives_need_less() -> None:
    needs = {each.name: each.demand["cpu"] for each in ROBOT.components()}
    assert needs["small_localiser"] < 0.5 * needs["localiser"]
    assert needs["near_face_recogniser"] < 0.7 * needs["face_recogniser"]


@pytest.mark.slow
def test_chooses_lesser_alternatives_only_where_there_is_too_little_room() -> None:
    chosen = poise.place(ROBOT, "serve").architectures
    assert not LESSER & set(chosen.values())
    main, vision = ROBOT.computers
    small = replace(vision, capacity={**vision.capacity, "cpu": 0.8})
    chosen = poise.place(replace(ROBOT, computers=(main, small)), "serve").architectures
    assert LESSER & set(chosen.values())
