"""Scenes that show how a running robot adapts, and measure it from outside."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from poise.model.robot import Robot
from poise.session.callbacks import Check, Say
from poise.session.scenes.cut_link import CutLinkScene, cut_link
from poise.session.scenes.lost_computer import LostComputerScene, lose_computer
from poise.session.scenes.manager_killed import ManagerKilledScene, kill_manager
from poise.session.scenes.overload import OverloadScene, overload
from poise.session.scenes.relayed import RelayScene, cut_one_link, freeze_agent
from poise.session.scenes.task_scene import TasksScene, tasks

Played = (
    OverloadScene
    | LostComputerScene
    | CutLinkScene
    | RelayScene
    | ManagerKilledScene
    | TasksScene
)
Play = Callable[[Robot, Say, Check], Played]

SCENES: Mapping[str, tuple[str, Play]] = {
    "overload": ("adapt", overload),
    "lost-computer": ("adapt", lose_computer),
    "cut-link": ("counted", cut_link),
    "cut-one-link": ("relay", cut_one_link),
    "frozen-agent": ("relay", freeze_agent),
    "manager-killed": ("counted", kill_manager),
    "tasks": ("tasks", tasks),
}
"""By name: the example whose robot plays it, and what plays it."""
