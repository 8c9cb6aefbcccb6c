"""The robot file and its profile, as the case study has them."""

from __future__ import annotations

from pathlib import Path

from poise.estimate.demands import with_profile
from poise.estimate.profile import file as profile_file
from poise.model import load

FILE = Path(__file__).parents[2] / "examples" / "trot" / "robot.yaml"
PROFILE = profile_file.read(FILE.with_name("profile.yaml"))
ROBOT = with_profile(load(FILE), PROFILE)
CPU = {name: each.cpu.mean for name, each in PROFILE.components.items()}


def test_has_the_components_of_the_case_study() -> None:
    counts = [len(architecture.components) for architecture in ROBOT.architectures]
    assert counts == [5, 4, 4, 7, 4]


def test_every_component_is_profiled() -> None:
    assert {component.name for component in ROBOT.components()} == CPU.keys()


def test_overloads_one_computer_and_fits_on_two() -> None:
    """A computer is half a core: between 130 % of one and 80 % of two."""
    computers = {c.name: c.capacity["cpu"] * c.speed for c in ROBOT.computers}
    assert computers == {"main": 0.5, "vision": 0.5}
    assert 0.65 < sum(CPU.values()) < 0.8
