"""From some components to others: what begins, what it waits for, and what stays."""

from __future__ import annotations

from math import inf
from typing import cast

import pytest

from poise.clock import boot_time
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.live_robot import DoesNotStart, LiveRobot
from poise.manage.journal import Journal
from poise.manage.observe.watch import Watch
from poise.manage.tasks.switch import LaterError, SlowStarts, prepare, switch
from poise.model.robot import Robot
from poise.wire.records.status_records import ComponentStatus, Fault
from tests.manage.conftest import FakeAgents, connector_names


@pytest.fixture
def agents() -> FakeAgents:
    return FakeAgents("left", "right")


@pytest.fixture
def live(robot: Robot, agents: FakeAgents) -> LiveRobot:
    live = LiveRobot(
        robot, {"grabber": "left"}, cast("Agents", agents), Journal(":memory:"), "/run"
    )
    live.start()
    live.goes_on_without_lost = True
    return live


def begin_slowly(live: LiveRobot, agents: FakeAgents) -> None:
    """Begin the thinker, which is not configured in time."""
    agents.states["thinker"] = ComponentStatus(name="thinker", state="unconfigured")
    with pytest.raises(LaterError):
        switch(live, (), {"thinker": "right"})


def test_what_is_at_work_out_of_reach_has_no_lease_when_it_begins_elsewhere(
    live: LiveRobot, agents: FakeAgents
) -> None:
    switch(live, (), {"thinker": "right"})
    agents.gone.add("right")
    live.commit(live.desired.without(["thinker"]), "a test")
    switch(live, (), {"thinker": "left"})
    assert agents.revoked == ["right"]


def test_what_is_prepared_begins_as_it_is_there_and_anew_elsewhere(
    live: LiveRobot, agents: FakeAgents
) -> None:
    prepare(live, {"thinker": "right"}, {})
    prepared = live.prefetched["thinker"]
    assert switch(live, (), {"thinker": "right"})
    assert live.placed["thinker"].key == prepared.key
    switch(live, ["thinker"], {})
    assert not switch(live, (), {"thinker": "left"})
    assert live.placed["thinker"].computer == "left"
    assert live.placed["thinker"].epoch > prepared.epoch
    switch(live, ["thinker"], {})
    agents.gone.add("left")
    switch(live, (), {"thinker": "right"})
    said = [each.what for each in live.journal.entries() if "anew" in each.what]
    anew = ["'thinker' begins anew on 'left': not all that is needed now fits"]
    anew += ["'thinker' begins anew on 'right': 'left', where it was idle"]
    assert said == [f"{anew[0]} where it was idle", f"{anew[1]}, is out of reach"]


def test_what_comes_to_rest_still_publishes_but_is_sent_nothing(
    live: LiveRobot, agents: FakeAgents
) -> None:
    switch(live, (), {"filter": "left", "thinker": "right"})
    agents.deployed.clear()
    switch(live, ["filter"], {})
    told = [each for computer, each in agents.deployed if computer == "left"]
    assert [connector_names(each) for each in told] == [
        {"eye": {"filter.clean-thinker.seen": "remote"}},
        {"eye": {}},
    ]


def test_what_rests_amid_a_failed_switch_is_joined_to_nothing(
    live: LiveRobot, agents: FakeAgents
) -> None:
    switch(live, (), {"filter": "left"})
    agents.states["thinker"] = ComponentStatus(name="thinker", state="failed")
    with pytest.raises(DoesNotStart):
        switch(live, ["filter"], {"thinker": "right"})
    assert live.prefetched["filter"].unjoined
    agents.states["thinker"] = ComponentStatus(name="thinker", state="unconfigured")
    switch(live, (), {"filter": "left"})
    with pytest.raises(LaterError):
        switch(live, ["filter"], {"thinker": "right"})
    assert live.prefetched["filter"].unjoined


def test_what_should_rest_may_be_at_work_until_its_agent_has_answered(
    live: LiveRobot, agents: FakeAgents
) -> None:
    switch(live, (), {"filter": "left"})
    switch(live, ["filter"], {})
    assert not live.coming_to_rest()
    agents.forget_status("left")
    assert live.coming_to_rest() == [live.prefetched["filter"]]
    assert not list(Watch(live).change())  # it may as well have rested for long
    agents.gone.add("left")
    assert not live.coming_to_rest()


def test_who_has_not_answered_yet_is_named_where_something_should_rest(
    live: LiveRobot, agents: FakeAgents
) -> None:
    switch(live, (), {"filter": "left"})
    agents.deaf.add("left")
    with pytest.raises(LaterError) as raised:
        switch(live, ["filter"], {"thinker": "right"})
    assert str(raised.value) == "computer 'left' is silent"


def test_only_where_all_was_prepared_a_switch_was_prepared(live: LiveRobot) -> None:
    prepare(live, {"thinker": "right"}, {})
    assert not switch(live, (), {"thinker": "right", "filter": "right"})


def test_what_cannot_begin_is_to_run_no_more(
    live: LiveRobot, agents: FakeAgents
) -> None:
    agents.states["thinker"] = ComponentStatus(name="thinker", state="failed")
    with pytest.raises(DoesNotStart, match="'thinker'"):
        switch(live, ["grabber"], {"thinker": "right"})
    assert not live.desired.coming
    assert not agents.statuses()["right"].containers


def test_what_takes_long_and_fails_meanwhile_does_not_start(
    live: LiveRobot, agents: FakeAgents
) -> None:
    slow = SlowStarts(live)
    begin_slowly(live, agents)
    slow.note(["thinker"], boot_time(), 0.0)
    assert slow.ready({"thinker": "right"}) == {}
    (ahead,) = live.desired.configured_ahead
    agents.report_component(
        "right", ComponentStatus(name="thinker", epoch=ahead.epoch, state="failed")
    )
    with pytest.raises(DoesNotStart, match="'thinker'"):
        slow.ready({"thinker": "right"})


def test_what_takes_long_and_crashes_again_and_again_does_not_start(
    live: LiveRobot, agents: FakeAgents
) -> None:
    slow = SlowStarts(live)
    begin_slowly(live, agents)
    before = [Fault(container="mind", message="crashed", number=n) for n in range(1, 6)]
    agents.note_faults(*before)
    slow.note(["thinker"], boot_time(), 0.0)
    assert slow.ready({"thinker": "right"}) == {}
    new = [Fault(container="mind", message="crashed", number=n) for n in range(6, 11)]
    agents.note_faults(*before, *new)
    with pytest.raises(DoesNotStart, match="container 'mind' on 'right' crashed"):
        slow.ready({"thinker": "right"})


def test_what_takes_long_begins_no_sooner_than_noted(
    live: LiveRobot, agents: FakeAgents
) -> None:
    slow = SlowStarts(live)
    begin_slowly(live, agents)
    (ahead,) = live.desired.configured_ahead
    ready = ComponentStatus(name="thinker", epoch=ahead.epoch, state="inactive")
    agents.report_component("right", ready)
    slow.note(["thinker"], boot_time(), 60.0)
    assert not slow.is_due()
    slow.note(["thinker"], boot_time(), 0.0)
    assert slow.is_due()


def test_what_takes_long_is_due_since_its_first_action_until_it_is_dropped(
    live: LiveRobot,
) -> None:
    slow = SlowStarts(live)
    slow.note(["thinker"], 5.0, 0.0)
    slow.note(["thinker", "filter"], 7.0, 0.0)
    assert slow.since(["filter", "thinker"]) == 5.0
    assert slow.since(["filter"]) == 7.0
    slow.keep({"filter": "left"})
    assert slow.since(["thinker"]) == inf
    assert slow.since(["filter"]) == 7.0
