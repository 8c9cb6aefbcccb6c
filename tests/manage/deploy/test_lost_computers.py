"""Agents that were restarted are told of, also when nobody saw them end."""

from types import SimpleNamespace
from typing import cast

from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.deploy.running_components import RunningComponents


def test_an_agent_that_was_back_before_anybody_looked_is_told_of() -> None:
    said: list[tuple[str, str]] = []
    right = SimpleNamespace(pid=7, adopted=0)
    agents = SimpleNamespace(
        obey=lambda _: True,
        statuses=lambda: {"right": right},
        is_cut_off=lambda _: False,
    )
    run = SimpleNamespace(
        computers=lambda: {"right"},
        agents=agents,
        excused=set(),
        unreached=dict,
        synchronise=lambda computer: said.append(("told again", computer)),
        journal=SimpleNamespace(note=lambda kind, what: said.append((kind, what))),
    )
    lost = LostComputers(cast("RunningComponents", run))
    lost.note()
    lost.bring_back()
    assert said == []
    right.pid, right.adopted = 8, 1
    for _ in range(2):
        lost.note()
        lost.bring_back()
    assert said == [
        ("wrong", "computer 'right' was cut off, or its agent was restarted"),
        ("told again", "right"),
        ("right", "the agent of 'right' was restarted; 1 container went on"),
    ]
