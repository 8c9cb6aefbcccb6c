"""Scenes that show how a running robot adapts, and measure it from outside."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from examples.demo.cut_link import CutLinkScene, cut_link
from examples.demo.lost_computer import LostComputerScene, lose_computer
from examples.demo.lost_leader import LostLeaderScene, lose_leader
from examples.demo.manager_killed import ManagerKilledScene, kill_manager
from examples.demo.overload import OverloadScene, overload
from examples.demo.relayed import RelayScene, cut_one_link, freeze_agent
from examples.demo.task_scene import TasksScene, tasks
from examples.demo.waiting import Check, Say
from poise import Robot

Played = (
    OverloadScene
    | LostComputerScene
    | LostLeaderScene
    | CutLinkScene
    | RelayScene
    | ManagerKilledScene
    | TasksScene
)
Play = Callable[[Robot, Say, Check], Played]

SCENES: Mapping[str, tuple[str, Play]] = {
    "overload": ("adapt", overload),
    "lost-computer": ("adapt", lose_computer),
    "lost-leader": ("relay", lose_leader),
    "cut-link": ("counted", cut_link),
    "cut-one-link": ("relay", cut_one_link),
    "frozen-agent": ("relay", freeze_agent),
    "manager-killed": ("counted", kill_manager),
    "tasks": ("tasks", tasks),
}
"""By name: the example whose robot plays it, and what plays it."""
