"""Scenes that show how a running robot adapts, and measure it from outside."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from poise.model.robot import Robot
from poise.session.say import Check, Say
from poise.session.scenes.lost_computer import LostComputerScene, lose_computer
from poise.session.scenes.overload import OverloadScene, overload

SCENES: Mapping[str, Callable[[Robot, Say, Check], OverloadScene | LostComputerScene]]
SCENES = {
    "overload": overload,
    "lost-computer": lose_computer,
}
"""By name; each takes the robot of examples/adapt."""
