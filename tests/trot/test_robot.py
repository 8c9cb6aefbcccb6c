"""The robot file and its profile, as the case study has them."""

from __future__ import annotations

from pathlib import Path

from poise.estimate.demands import with_profile
from poise.estimate.profile import file as profile_file
from poise.model import load

FILE = Path(__file__).parents[2] / "examples" / "trot" / "robot.yaml"
PROFILE = profile_file.read(FILE.with_name("profile.yaml"))
ROBOT = with_profile(load(FILE), PROFILE)
VISION = {"object_detector", "head_turner"}
"""They need devices of `vision`."""


def test_has_the_components_of_the_case_study() -> None:
    counts = [len(architecture.components) for architecture in ROBOT.architectures]
    assert counts == [5, 4, 4, 7, 4]


def test_every_component_is_profiled() -> None:
    names = {component.name for component in ROBOT.components()}
    assert names == PROFILE.components.keys()


def test_overloads_one_computer_and_fits_on_two() -> None:
    """What may be on `main` needs more than it has; all needs less than both have."""
    has = {c.name: c.capacity["cpu"] * c.speed for c in ROBOT.computers}
    assert has == {"main": 0.5, "vision": 0.5}
    needs = {
        component.name: component.demand["cpu"] for component in ROBOT.components()
    }
    assert sum(cpu for name, cpu in needs.items() if name not in VISION) > 1.2 * 0.5
    assert sum(needs.values()) < 0.95 * 2 * 0.5
