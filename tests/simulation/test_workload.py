"""What simulated components do, from what was measured and what the code says."""

from __future__ import annotations

import pytest
from msgspec import structs

from poise.estimate.profiles import (
    ConnectorProfile,
    Costs,
    HandlerProfile,
    KindCosts,
    Profile,
)
from poise.model.robot import Link, Robot
from poise.model.software import CodeTimer, ComponentCode
from poise.simulation.link_models import LinkModel, links_of
from poise.simulation.workload import SimulatedWork, workload_of
from tests.simulation.conftest import small_scenario
from tests.simulation.test_rehearsal import profile_of


@pytest.fixture
def robot() -> Robot:
    return small_scenario().robot


def cpu_of(work: SimulatedWork, component: str, coming: float) -> float:
    """Return what a model takes when messages come at a rate [1/s]."""
    model = work.models[component]
    timers = sum(t.handler.work / t.timer.period for t in model.timers)
    return timers + sum(coming * each.work for each in model.takes.values())


@pytest.mark.parametrize("component", ["camera", "filter", "mind", "arm"])
def test_all_handlers_together_take_what_was_measured(
    robot: Robot, component: str
) -> None:
    work = workload_of(robot, profile_of(robot, **{component: 0.3}))
    assert cpu_of(work, component, coming=10.0) == pytest.approx(0.3)


def test_timers_take_what_they_were_measured_to_take_and_messages_the_rest(
    robot: Robot,
) -> None:
    profile = profile_of(robot, filter=0.3)
    measured = profile.components["filter"]
    tick = structs.replace(measured.timers["tick"], median=0.02, p99=0.04)
    known = structs.replace(measured, timers={"tick": tick})
    profile = structs.replace(
        profile, components={**profile.components, "filter": known}, speed=0.5
    )
    model = workload_of(robot, profile).models["filter"]
    (timer,) = model.timers
    # 20 ms of a computer of half speed, ten times a second: 0.1 of the 0.3 cores
    assert timer.handler.work == pytest.approx(0.01)
    assert 0.2 < timer.handler.spread < 0.4  # log(2) / 2.33
    (message,) = model.takes.values()
    assert message.work == pytest.approx(0.02)


@pytest.mark.parametrize(("median", "follows"), [(0.08, True), (0.01, False)])
def test_a_timer_that_waits_far_longer_than_it_computes_follows_a_device(
    robot: Robot, *, median: float, follows: bool
) -> None:
    profile = profile_of(robot)
    measured = profile.components["mind"]
    known = structs.replace(
        measured,
        timers={"tick": structs.replace(measured.timers["tick"], median=median)},
        handlers={"tick": HandlerProfile(mean=0.001, median=0.001, p99=0.002)},
    )
    profile = structs.replace(profile, components={**profile.components, "mind": known})
    assert workload_of(robot, profile).models["mind"].follows_device == follows


def test_a_connector_is_fed_by_the_handler_of_its_rate(robot: Robot) -> None:
    """Of the filter's timer at 10 Hz every second run sends, of 5 messages a second."""
    profile = profile_of(robot)
    out = "filter.out-mind.seen"
    slower = structs.replace(profile.connectors[out], messages=5.0)
    profile = structs.replace(profile, connectors={**profile.connectors, out: slower})
    (timer,) = workload_of(robot, profile).models["filter"].timers
    assert timer.handler.publishes == {out: 0.5}


def test_what_nobody_says_is_guessed_and_said(robot: Robot) -> None:
    work = workload_of(robot, None)
    assert "nothing sends over" not in " ".join(work.guesses)
    assert any("'arm'" in guess for guess in work.guesses)
    assert work.models["arm"].timers == ()


def test_sending_over_a_wire_costs_more_than_together(robot: Robot) -> None:
    costs = {
        "local": KindCosts(source=Costs(message=1e-4)),
        "remote": KindCosts(source=Costs(message=3e-4, byte=1e-7)),
    }
    profile: Profile = structs.replace(profile_of(robot), costs=costs)
    traffic = workload_of(robot, profile).traffic
    name = str(next(robot.all_connectors()))
    assert traffic.cost(name, "remote", "local", "source") == pytest.approx(3e-4)
    assert traffic.cost(name, "local", "local", "source") == 0.0
    assert traffic.apart(name, "local") == pytest.approx(3e-4)


def test_a_connector_is_fed_by_the_handler_whose_code_names_its_port(
    robot: Robot,
) -> None:
    """The filter's timer and its subscription have one rate."""
    out = "filter.out-mind.seen"
    for sends, is_by_timer in (("tick", True), ("raw", False)):
        code = ComponentCode(
            timers=(CodeTimer("tick", 0.1, None),), sends={sends: ("out",)}
        )
        known = structs.replace(robot, code={"filter": code})
        model = workload_of(known, profile_of(robot)).models["filter"]
        (timer,), (message,) = model.timers, model.takes.values()
        assert (out in (timer.handler.publishes or {})) == is_by_timer
        assert (out in (message.publishes or {})) != is_by_timer


def test_what_comes_from_an_alternative_is_handled_as_what_comes_from_the_other(
    robot: Robot,
) -> None:
    """The same work and the same messages on, though only one of them runs."""
    see = robot.architecture("see")
    (out,) = (c for c in robot.connectors if c.between[0].component == "filter")
    end = structs.replace(out.between[0], component="small_filter")
    small = structs.replace(robot.component("filter"), name="small_filter")
    also = structs.replace(see, name="small", components=(small,), connectors=())
    both = structs.replace(
        robot,
        architectures=(*robot.architectures, also),
        connectors=(
            *robot.connectors,
            structs.replace(out, between=(end, out.between[1]), rate=10.0),
        ),
    )
    profile = profile_of(robot, mind=0.3)
    alone = workload_of(robot, profile).models["mind"]
    (takes,) = alone.takes.values()
    beside = workload_of(both, profile).models["mind"]
    assert len(beside.takes) == 2
    for model in beside.takes.values():
        assert model.work == pytest.approx(takes.work)
        assert model.publishes == takes.publishes


def test_without_a_profile_a_timer_takes_its_part_beside_messages(
    robot: Robot,
) -> None:
    """20 runs of a timer and 10 messages a second share 0.3 cores: 10 ms each."""
    ticking = structs.replace(
        robot.with_components(
            lambda c: structs.replace(c, demand={**c.demand, "cpu": 0.3 * 1.05})
        ),
        code={"filter": ComponentCode(timers=(CodeTimer("tick", 0.05, None),))},
    )
    bag = {str(c): ConnectorProfile(messages=10.0) for c in robot.all_connectors()}
    model = workload_of(ticking, None, bag=bag).models["filter"]
    (timer,) = model.timers
    (message,) = model.takes.values()
    assert timer.handler.work == pytest.approx(0.01)
    assert message.work == pytest.approx(0.01)


def test_a_link_that_says_only_its_latency_is_as_quick_as_usual(robot: Robot) -> None:
    link = Link(between=("head", "body"), latency=0.001)
    ((_, slow),) = links_of(structs.replace(robot, links=(link,))).items()
    assert slow == LinkModel(latency=0.001, jitter=0.00025)
    declared = structs.replace(link, bandwidth=1e6)
    ((_, narrow),) = links_of(structs.replace(robot, links=(declared,))).items()
    assert narrow.bandwidth == 1e6
