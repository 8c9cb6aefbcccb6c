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
from poise.model.robot import ComponentEntry, Connector, ConnectorEnd, Link, Robot
from poise.model.software import CodeTimer, ComponentCode
from poise.simulation.link_models import LinkModel, links_of
from poise.simulation.workload import LEFT_OUT, NO_WAITS, SimulatedWork, workload_of
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


@pytest.mark.parametrize(("loops", "work"), [(0.0, 0.01), (5e3, 0.02)])
def test_timers_take_what_they_were_measured_to_take_and_messages_the_rest(
    robot: Robot, *, loops: float, work: float
) -> None:
    """20 ms of a computer of half speed, ten times a second.

    That is 0.1 of the 0.3 cores of a real one, and 0.2 where it was emulated.
    """
    profile = profile_of(robot, filter=0.3)
    measured = profile.components["filter"]
    tick = structs.replace(measured.timers["tick"], median=0.02, p99=0.04)
    known = structs.replace(measured, timers={"tick": tick})
    profile = structs.replace(
        profile,
        components={**profile.components, "filter": known},
        speed=0.5,
        loops=loops,
    )
    model = workload_of(robot, profile).models["filter"]
    (timer,) = model.timers
    assert timer.handler.work == pytest.approx(work)
    assert 0.2 < timer.handler.spread < 0.4  # log(2) / 2.33
    (message,) = model.takes.values()
    assert message.work == pytest.approx(0.03 - work)


def waiting(
    robot: Robot, component: str, seconds: float, share: float = 1.0
) -> Profile:
    """Return a profile in which the runs of a timer of 10 Hz wait."""
    profile = profile_of(robot)
    measured = profile.components[component]
    tick = structs.replace(measured.timers["tick"], median=seconds + 0.001)
    taken = HandlerProfile(
        mean=0.001,
        median=0.001,
        p99=0.002,
        waiting=share,
        wait=seconds,
        wait_p99=2 * seconds,
    )
    known = structs.replace(measured, timers={"tick": tick}, handlers={"tick": taken})
    return structs.replace(profile, components={**profile.components, component: known})


@pytest.mark.parametrize(("seconds", "follows"), [(0.08, True), (0.01, False)])
def test_a_source_whose_timer_waits_far_longer_than_it_computes_follows_a_device(
    robot: Robot, *, seconds: float, follows: bool
) -> None:
    model = workload_of(robot, waiting(robot, "camera", seconds)).models["camera"]
    assert model.follows_device == follows
    (timer,) = model.timers
    assert timer.handler.wait == (0.0 if follows else seconds)


def test_what_waits_for_room_in_a_queue_follows_no_device(robot: Robot) -> None:
    code = {"filter": ComponentCode(blocks=("raw",))}
    profile = waiting(robot, "camera", 0.08)
    work = workload_of(structs.replace(robot, code=code), profile)
    model = work.models["camera"]
    assert not model.follows_device
    (timer,) = model.timers
    assert timer.handler.wait == 0.08
    assert any("waits for room in the queue" in guess for guess in work.guesses)


def test_a_port_keeps_as_many_messages_whoever_sends_them(robot: Robot) -> None:
    """The camera and the arm send to one port of the filter."""
    known, *others = robot.architectures
    one = next(c for c in known.connectors if c.between[1].component == "filter")
    other = structs.replace(one, between=(ConnectorEnd("arm", "out"), one.between[1]))
    both = structs.replace(known, connectors=(*known.connectors, other))
    code = {"filter": ComponentCode(keep={one.between[1].port: 3})}
    robot = structs.replace(robot, architectures=(both, *others), code=code)
    assert workload_of(robot, profile_of(robot)).models["filter"].keep == [
        ([str(one), str(other)], 3)
    ]


@pytest.mark.parametrize("seconds", [0.08, 0.01])
def test_who_takes_messages_waits_as_it_was_measured(
    robot: Robot, seconds: float
) -> None:
    model = workload_of(robot, waiting(robot, "filter", seconds)).models["filter"]
    assert not model.follows_device
    (timer,) = model.timers
    assert timer.handler.wait == seconds
    assert timer.handler.wait_spread == pytest.approx(0.3, rel=0.02)  # log(2) / 2.33
    (message,) = model.takes.values()
    assert message.wait == 0.0


@pytest.mark.parametrize(("share", "counts"), [(0.001, False), (0.3, True)])
def test_waits_of_very_few_runs_are_none(
    robot: Robot, *, share: float, counts: bool
) -> None:
    profile = waiting(robot, "filter", 0.03, share)
    handler = workload_of(robot, profile).models["filter"].timers[0].handler
    assert (handler.waiting, handler.wait) == ((share, 0.03) if counts else (0.0, 0.0))


def test_a_call_takes_what_it_was_measured_to_take(robot: Robot) -> None:
    """The arm takes a tenth of a core for ten calls and ten messages a second."""
    profile = profile_of(robot, arm=0.1)
    name = str(
        next(c for c in robot.all_connectors() if c.between[1].component == "arm")
    )
    taken = HandlerProfile(
        mean=0.004, median=0.004, p99=0.008, waiting=1.0, wait=0.05, wait_p99=0.1
    )
    called = ConnectorProfile(calls=10.0, size=100.0, answering=taken)
    profile = structs.replace(profile, connectors={**profile.connectors, name: called})
    (served,) = workload_of(robot, profile).models["arm"].serves.values()
    assert served.work == pytest.approx(0.004)
    assert (served.wait, served.spread) == (0.05, served.wait_spread)
    assert served.spread == pytest.approx(0.3, rel=0.02)  # log(2) / 2.33


def test_a_connector_is_fed_by_the_handler_of_its_rate(robot: Robot) -> None:
    """Of the filter's timer at 10 Hz every second run sends, of 5 messages a second."""
    profile = profile_of(robot)
    out = "filter.out-mind.seen"
    slower = structs.replace(profile.connectors[out], messages=5.0)
    profile = structs.replace(profile, connectors={**profile.connectors, out: slower})
    (timer,) = workload_of(robot, profile).models["filter"].timers
    assert timer.handler.publishes == {out: 0.5}


def test_one_way_calls_go_out_beside_calls_over_the_same_connector(
    robot: Robot,
) -> None:
    """Of the filter's timer at 10 Hz each run calls, and every fifth also notes."""
    profile = profile_of(robot)
    out = "filter.out-mind.seen"
    both = structs.replace(profile.connectors[out], calls=10.0, messages=2.0)
    profile = structs.replace(profile, connectors={**profile.connectors, out: both})
    (timer,) = workload_of(robot, profile).models["filter"].timers
    assert timer.handler.calls == {out: 1.0}
    assert timer.handler.publishes == {out: 0.2}


@pytest.mark.parametrize(
    ("cpu", "missed", "said"), [(0.001, 0.4, 1), (0.09, 0.4, 0), (0.001, 0.01, 0)]
)
def test_says_of_a_timer_that_was_late_by_waiting_that_it_does_not_wait_here(
    robot: Robot, *, cpu: float, missed: float, said: int
) -> None:
    profile = profile_of(robot)
    measured = profile.components["camera"]
    tick = structs.replace(measured.timers["tick"], median=0.1, p99=0.12, missed=missed)
    known = structs.replace(
        measured,
        timers={"tick": tick},
        handlers={"tick": HandlerProfile(mean=cpu, median=cpu, p99=cpu)},
    )
    profile = structs.replace(profile, components={"camera": known})
    guesses = [g for g in workload_of(robot, profile).guesses if g.endswith(LEFT_OUT)]
    head = "'camera.tick' missed 40% of its deadlines when it was profiled: "
    assert guesses == [head + LEFT_OUT] * said


def test_what_nobody_says_is_guessed_and_said(robot: Robot) -> None:
    work = workload_of(robot, None)
    assert "nothing sends over" not in " ".join(work.guesses)
    said = "'arm' has no timer and gets nothing: only its CPU counts"
    assert said in work.guesses
    assert cpu_of(work, "arm", coming=0.0) == pytest.approx(0.2 / 1.05)


def test_says_whose_cpu_is_not_known(robot: Robot) -> None:
    """Nothing is late where nothing takes CPU."""
    first, *others = robot.architectures
    new = ComponentEntry(name="new", command=("x",), demand={"memory": 1e6})
    first = structs.replace(first, components=(*first.components, new))
    grown = structs.replace(robot, architectures=(first, *others))
    said = "no CPU is known of 'new': it takes none here"
    for profile in (None, profile_of(robot)):
        assert said in workload_of(grown, profile).guesses
        before = workload_of(robot, profile)
        assert not any("no CPU is known" in guess for guess in before.guesses)


def test_programs_take_the_cpu_that_the_robot_file_gives_them(robot: Robot) -> None:
    """Also one that hears a topic of ROS 2, which no simulated component sends."""
    first, *others = robot.architectures
    names = ["program", "node"]
    programs = tuple(
        ComponentEntry(name=name, command=("x",), demand={"cpu": 0.42})
        for name in names
    )
    ends = tuple(ConnectorEnd(component=name, port="") for name in names)
    topic = Connector(between=(ends[0], ends[1]), topic="/scan", rate=10.0)
    first = structs.replace(
        first,
        components=(*first.components, *programs),
        connectors=(*first.connectors, topic),
    )
    robot = structs.replace(robot, architectures=(first, *others))
    work = workload_of(robot, None)
    for name in names:
        assert cpu_of(work, name, coming=0.0) == pytest.approx(0.4)
    assert "'node' is a program: only its CPU counts, one core at most" in work.guesses


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


def test_a_timer_that_skipped_releases_sends_as_much_in_each_run(robot: Robot) -> None:
    """Runs of 150 ms, due at 10 Hz, sent and called at 6.7 Hz: one each in each run."""
    out = "filter.out-mind.seen"
    profile = profile_of(robot, filter=0.2)
    measured = profile.components["filter"]
    tick = structs.replace(measured.timers["tick"], median=0.15)
    known = structs.replace(measured, timers={"tick": tick})
    profile = structs.replace(
        profile,
        components={**profile.components, "filter": known},
        connectors={**profile.connectors, out: ConnectorProfile(messages=1 / 0.15)},
    )
    code = ComponentCode(
        timers=(CodeTimer("tick", 0.1, None),), sends={"tick": ("out",)}
    )
    model = workload_of(structs.replace(robot, code={"filter": code}), profile).models[
        "filter"
    ]
    (timer,) = model.timers
    assert timer.handler.publishes == {out: 1.0}


def test_says_that_a_profile_does_not_know_what_handlers_wait_for(robot: Robot) -> None:
    """An older Poise wrote how much CPU they take, and nothing of waits."""
    taken = HandlerProfile(mean=0.001, median=0.001, p99=0.002)
    for waiting_share, is_said in ((None, True), (0.0, False)):
        profile = profile_of(robot)
        handlers = {"tick": structs.replace(taken, waiting=waiting_share)}
        components = {
            name: structs.replace(known, handlers=handlers)
            for name, known in profile.components.items()
        }
        work = workload_of(robot, structs.replace(profile, components=components))
        assert (NO_WAITS in work.guesses) == is_said
    assert NO_WAITS in workload_of(robot, profile_of(robot)).guesses  # nor of CPU
    assert NO_WAITS.endswith("need a longer --for")  # a short one has no run of some


@pytest.mark.parametrize("starts", [{}, {"tick": {"out": False}}])
def test_what_starts_calls_goes_on_and_takes_the_answers_later(
    robot: Robot, starts: dict[str, dict[str, bool]]
) -> None:
    out = "filter.out-mind.seen"
    code = ComponentCode(
        timers=(CodeTimer("tick", 0.1, None),),
        sends={"tick": ("out",), "answer": ()},
        starts=starts,
    )
    profile = profile_of(robot)
    called = {**profile.connectors, out: ConnectorProfile(calls=10.0, size=10.0)}
    known = structs.replace(robot, code={"filter": code})
    model = workload_of(known, structs.replace(profile, connectors=called)).models[
        "filter"
    ]
    (timer,) = model.timers
    assert (out in timer.handler.started, out in timer.handler.calls) == (
        bool(starts),
        not starts,
    )
    assert (model.answer is not None) == bool(starts)
