"""Components of the next actions wait, prepared, and hurt nobody."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import pytest
from msgspec.structs import replace

from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.observe.estimates import Load
from poise.manage.tasks.action_placement import LikelyAction
from poise.manage.tasks.prefetch import TRY_AGAIN, Prefetcher
from poise.manage.tasks.switch import switch
from poise.model.robot import Robot
from poise.model.steps import Prefetch
from poise.wire.records.status_records import ComponentStatus, ContainerHealth, Fault
from tests.manage.conftest import FakeAgents

NEXT = LikelyAction(
    what="action 'think' of task 'serve'",
    placement={"thinker": "right"},
    probability=0.8,
)


class Rig:
    """A run of `grabber` on the left, and what may be prepared beside it."""

    def __init__(self, robot: Robot) -> None:
        self.agents = FakeAgents("left", "right")
        self.journal = Journal(":memory:")
        agents = cast("Agents", self.agents)
        self.run = LiveRobot(robot, {"grabber": "left"}, agents, self.journal, "/run")
        self.run.start()
        self.now = 0.0
        self.prefetch = Prefetcher(self.run, lambda: self.now)

    def look(
        self, *likely: LikelyAction, loads: Mapping[str, Load] | None = None
    ) -> None:
        self.prefetch.update(likely, lambda: loads or {})

    def told(self, computer: str) -> list[tuple[str, Any]]:
        """Return the containers sent last to an agent, and their preparation CPU."""
        found = [told for at, told in self.agents.deployed if at == computer]
        return [(each.name, each.preparation_cpu) for each in found[-1].containers]

    def said(self, kind: str) -> list[str]:
        return [e.what for e in self.journal.entries() if e.kind == kind]


@pytest.fixture
def rig(robot: Robot) -> Rig:
    return Rig(robot)


def test_the_next_action_is_prepared_in_half_of_the_cpu_that_is_left(rig: Rig) -> None:
    rig.look(NEXT)
    assert rig.run.prefetched["thinker"].computer == "right"
    assert rig.told("right") == [("mind", 0.5)]
    assert not rig.agents.deployed[-1][1].containers[0].connectors
    rig.look(NEXT)
    assert rig.said("decided")[-1] == (
        "action 'think' of task 'serve' is likely next: 'thinker' prepared"
    )
    assert rig.said("done")[-1] == "'thinker' prepared within 0.00 s"
    assert rig.prefetch.report().prepared == {"thinker": "right"}


def test_what_is_prepared_begins_as_a_hit_and_gets_its_cpu(rig: Rig) -> None:
    rig.look(NEXT)
    assert switch(rig.run, ["grabber"], {"thinker": "right"})
    assert rig.told("right") == [("mind", 0.0)]
    assert rig.run.placed["thinker"].epoch == 0
    assert not switch(rig.run, ["thinker"], {"filter": "left"})


def test_switches_are_reported_with_and_without(rig: Rig) -> None:
    for milliseconds in range(1, 101):
        rig.run.switches.note(milliseconds * 1e-3, is_hit=True)
    rig.run.switches.note(1.0, is_hit=False)
    report = rig.prefetch.report()
    assert (report.hit.median, report.hit.p99) == (0.0505, 0.099)
    assert str(report) == (
        "100 prepared (50 ms, p99 99 ms), 1 not prepared (1000 ms, p99 1000 ms)"
    )


def test_nothing_is_prepared_when_that_is_off(robot: Robot) -> None:
    rig = Rig(replace(robot, prefetch=Prefetch(off=True)))
    rig.look(NEXT)
    assert not rig.run.prefetched


def test_nothing_begins_while_other_programs_use_all_cpu(rig: Rig) -> None:
    full = Load(capacity=1.0, used=1.0, background=0.9)
    rig.look(NEXT, loads={"right": full})
    assert not rig.run.prefetched
    rig.look(NEXT, loads={"right": full})
    assert rig.said("seen") == [
        (
            "nothing is prepared for action 'think' of task 'serve': the running "
            "components leave no CPU free on 'right'"
        )
    ]


def test_a_preparation_that_fails_is_said_and_dropped(rig: Rig) -> None:
    rig.agents.states["thinker"] = ComponentStatus(
        name="thinker", state="failed", error="Traceback\nKeyError: 'map'"
    )
    rig.look(NEXT)
    rig.run.wait(rig.run.placed.values(), 1.0)  # what runs does not mind
    rig.look(NEXT)
    assert rig.said("failed") == [
        (
            "component 'thinker' cannot be prepared on 'right'; it starts only with "
            "its action: KeyError: 'map'"
        )
    ]
    assert not rig.run.prefetched
    assert rig.told("right") == []
    rig.look(NEXT)
    assert not rig.run.prefetched
    rig.now += TRY_AGAIN
    rig.look(NEXT)
    assert rig.run.prefetched


def test_a_container_that_crashes_as_it_is_prepared_is_not_tried_on(rig: Rig) -> None:
    rig.look(NEXT)
    crashed = Fault(container="mind", message="was killed by SIGSEGV", number=1)
    status = rig.agents.statuses()["right"]
    health = ContainerHealth(
        name="mind", state="running", since=0.0, restarts=1, last_fault=crashed
    )
    rig.agents._statuses["right"] = replace(status, health=(health,))
    rig.look(NEXT)
    assert not rig.run.prefetched
    assert rig.said("failed") == [
        (
            "component 'thinker' cannot be prepared on 'right'; it starts only with "
            "its action: was killed by SIGSEGV"
        )
    ]


def test_an_action_begins_anew_what_failed_when_it_was_prepared(rig: Rig) -> None:
    rig.agents.states["thinker"] = ComponentStatus(name="thinker", state="failed")
    rig.look(NEXT)
    del rig.agents.states["thinker"]
    switch(rig.run, [], {"thinker": "right"})
    assert rig.run.placed["thinker"].epoch == 1


def test_what_is_not_likely_any_more_rests_once_it_is_ready(rig: Rig) -> None:
    rig.look(NEXT)
    rig.look(NEXT)
    assert rig.run.prefetched["thinker"].gently
    rig.look()
    assert not rig.run.prefetched["thinker"].gently


def test_what_is_not_likely_any_more_and_not_ready_is_dropped(rig: Rig) -> None:
    rig.agents.states["thinker"] = ComponentStatus(name="thinker", state="unconfigured")
    rig.look(NEXT)
    rig.look()
    assert not rig.run.prefetched


def test_what_is_dropped_unused_counts_as_wasted(rig: Rig, robot: Robot) -> None:
    rig.look(NEXT)
    status = rig.agents.statuses()["right"]
    health = ContainerHealth(name="mind", state="running", since=0.0, memory=7_000_000)
    rig.agents._statuses["right"] = replace(status, health=(health,))
    rig.look(NEXT)
    assert rig.prefetch.report().memory == 7_000_000
    rig.run.robot = robot.with_components(
        lambda c: replace(c, demand={**c.demand, "memory": 6e8})
    )
    rig.now += 1.0
    rig.look(NEXT)
    rig.look(NEXT)
    assert not rig.run.prefetched
    assert rig.said("decided")[-1] == "'thinker' no longer kept prepared"
    assert rig.prefetch.report().wasted == 7_000_000


def test_a_stop_ends_what_is_prepared(rig: Rig) -> None:
    rig.look(NEXT)
    stop(rig.run)
    assert rig.told("right") == []
