"""How old data gets on a placement, against what can be worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from poise.model.robot import (
    Architecture,
    Chain,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Link,
    Robot,
)
from poise.runtime.component.ports import Timer
from poise.simulation.component_models import (
    ComponentModel,
    HandlerModel,
    Models,
    TimerModel,
    Traffic,
)
from poise.simulation.predicted_times import PredictedChain, predict_times
from poise.simulation.workload import SimulatedWork

EYE_MIND, MIND_ARM = "eye.seen-mind.seen", "mind.wish-arm.wish"
ALL_LEFT = dict.fromkeys(("eye", "mind", "arm"), "left")


@pytest.fixture
def robot() -> Robot:
    """Return a chain of three, each in a container of its own."""
    return Robot(
        name="some",
        folder="/some",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0}) for name in ("left", "right")
        ),
        links=(Link(between=("left", "right"), bandwidth=1e6, latency=0.02),),
        architectures=(
            Architecture(
                name="all",
                function="all",
                components=tuple(
                    ComponentEntry(name=name, isolated=True)
                    for name in ("eye", "mind", "arm", "hog")
                ),
                connectors=(
                    _connector("eye.seen", "mind.seen"),
                    _connector("mind.wish", "arm.wish"),
                ),
            ),
        ),
        chains=(Chain(name="see", through=("eye", "mind", "arm"), deadline=0.1),),
    )


def _connector(source: str, target: str) -> Connector:
    ends = (ConnectorEnd(*end.split(".")) for end in (source, target))
    return Connector(between=tuple(ends))  # type: ignore[arg-type]


def timer(period: float, work: float, *slots: str) -> TimerModel:
    return TimerModel(
        timer=Timer("tick", period, period), handler=_sending(work, *slots)
    )


def _sending(work: float, *slots: str) -> HandlerModel:
    return HandlerModel(work=work, publishes=dict.fromkeys(slots, 1.0))


PASSED_ON: Models = {
    "eye": ComponentModel(timers=(timer(0.1, 0.001, EYE_MIND),)),
    "mind": ComponentModel(timers=(), takes={EYE_MIND: _sending(0.01, MIND_ARM)}),
    "arm": ComponentModel(timers=(), takes={MIND_ARM: _sending(0.005)}),
}


def predicted(
    robot: Robot,
    placement: Mapping[str, str] = ALL_LEFT,
    models: Models = PASSED_ON,
    sizes: Mapping[str, float] = {},
) -> PredictedChain:
    work = SimulatedWork(models=models, traffic=Traffic(sizes=sizes))
    (chain,) = predict_times(robot, placement, work).chains
    return chain


def test_what_is_passed_on_at_once_is_as_old_as_the_work_takes(robot: Robot) -> None:
    chain = predicted(robot)
    assert chain.median == pytest.approx(0.015, rel=0.1)
    assert chain.p99 == pytest.approx(0.015, rel=0.1)
    assert [hop.component for hop in chain.hops] == ["mind", "arm"]
    assert chain.slowest == "mind"
    assert chain.late == 0.0
    assert chain.margin == pytest.approx(0.1 - chain.p99)


def test_what_waits_for_something_else_than_cpu_gets_older(robot: Robot) -> None:
    """It leaves the computer to a hog meanwhile, which takes half of its own CPU."""
    waits = replace(_sending(0.01, MIND_ARM), waiting=1.0, wait=0.03)
    models = {**PASSED_ON, "mind": ComponentModel(timers=(), takes={EYE_MIND: waits})}
    assert predicted(robot, models=models).median == pytest.approx(0.045, rel=0.05)
    models["hog"] = ComponentModel(timers=(timer(0.01, 1.0),))
    chain = predicted(robot, {**ALL_LEFT, "hog": "left"}, models)
    assert chain.median == pytest.approx(0.03 + 2 * 0.015, rel=0.1)


def test_waits_may_be_of_any_length(robot: Robot) -> None:
    waits = replace(_sending(0.01, MIND_ARM), waiting=1.0, wait=0.01, wait_spread=0.5)
    models = {**PASSED_ON, "mind": ComponentModel(timers=(), takes={EYE_MIND: waits})}
    chain = predicted(robot, models=models)
    assert chain.median == pytest.approx(0.025, rel=0.1)
    # 10 ms x exp(0.5 x 2.33) = 32 ms, over 50 runs each
    assert 0.035 < chain.p99 < 0.06


def test_a_third_of_the_runs_waits(robot: Robot) -> None:
    waits = replace(_sending(0.01, MIND_ARM), waiting=1 / 3, wait=0.06)
    models = {**PASSED_ON, "mind": ComponentModel(timers=(), takes={EYE_MIND: waits})}
    chain = predicted(robot, models=models)
    assert chain.median == pytest.approx(0.015, rel=0.1)
    assert chain.p99 == pytest.approx(0.075, rel=0.1)


@pytest.mark.parametrize(
    ("how", "seconds"),
    [("calls", 0.075), ("joined", 0.045), ("started", 0.015), ("answer", 0.035)],
)
def test_what_calls_two_waits_for_both_or_for_the_longest_or_for_none(
    robot: Robot, how: str, seconds: float
) -> None:
    """Each answers after 30 ms; in a turn of its own the answer is sent on."""
    asks = {"mind.one-one.look": 1.0, "mind.other-other.look": 1.0}
    (architecture,) = robot.architectures
    joins = [_connector(*ask.split("-")) for ask in asks]
    more = replace(
        architecture,
        components=(
            *architecture.components,
            *(ComponentEntry(name=name, isolated=True) for name in ("one", "other")),
        ),
        connectors=(*architecture.connectors, *joins),
    )
    sends = {MIND_ARM: 0.5 if how == "answer" else 1.0}
    mind = HandlerModel(work=0.01, publishes={} if how == "answer" else sends)
    mind = replace(mind, **{"started" if how == "answer" else how: asks})
    answer = HandlerModel(work=0.0, publishes=sends) if how == "answer" else None
    looks = HandlerModel(work=1e-5, waiting=1.0, wait=0.03)
    one, other = (ComponentModel(timers=(), serves={ask: looks}) for ask in asks)
    mind_model = ComponentModel(timers=(), takes={EYE_MIND: mind}, answer=answer)
    models = {**PASSED_ON, "mind": mind_model, "one": one, "other": other}
    placement = {**ALL_LEFT, "one": "left", "other": "left"}
    chain = predicted(replace(robot, architectures=(more,)), placement, models)
    assert chain.median == pytest.approx(seconds, rel=0.05)


def test_a_chain_ends_in_the_turn_of_an_answer(robot: Robot) -> None:
    ask = "mind.one-one.look"
    (architecture,) = robot.architectures
    more = replace(
        architecture,
        components=(*architecture.components, ComponentEntry(name="one")),
        connectors=(*architecture.connectors, _connector(*ask.split("-"))),
    )
    chain = Chain(name="look", through=("one", "mind"), deadline=0.1)
    starts = HandlerModel(work=1e-5, started={ask: 1.0})
    models = {
        **PASSED_ON,
        "mind": ComponentModel(
            timers=(), takes={EYE_MIND: starts}, answer=HandlerModel(work=0.02)
        ),
        "one": ComponentModel(timers=(), serves={ask: HandlerModel(work=0.01)}),
    }
    looking = replace(robot, architectures=(more,), chains=(chain,))
    found = predicted(looking, {**ALL_LEFT, "one": "left"}, models)
    assert found.median == pytest.approx(0.02, rel=0.1)


def test_a_timer_takes_what_came_within_a_period(robot: Robot) -> None:
    """So its age is spread over that period, if the timers' periods have no ratio."""
    sampling = ComponentModel(
        timers=(timer(0.0314, 0.0, MIND_ARM),), takes={EYE_MIND: _sending(0.0)}
    )
    chain = predicted(robot, models={**PASSED_ON, "mind": sampling})
    assert chain.median == pytest.approx(0.05 + 0.005, rel=0.15)
    assert chain.p99 == pytest.approx(0.1 + 0.005, rel=0.15)
    assert 0.0 < chain.late < 0.1


def test_data_of_a_device_is_of_any_age_within_a_period(robot: Robot) -> None:
    """Its phase differs from run to run: the mean is what is known beforehand."""
    sampled = timer(0.1, 0.001, MIND_ARM)
    models = {
        **PASSED_ON,
        "mind": ComponentModel(timers=(sampled,), takes={EYE_MIND: _sending(0.001)}),
    }
    fixed = predicted(robot, models=models)
    eye = replace(models["eye"], follows_device=True)
    device = predicted(robot, models={**models, "eye": eye})
    assert device.median != pytest.approx(fixed.median, rel=0.01)
    assert 0.03 < device.median < 0.08


def test_a_link_is_crossed_as_often_as_the_chain_crosses_it(robot: Robot) -> None:
    apart = {"eye": "left", "mind": "right", "arm": "left"}
    chain = predicted(robot, apart, sizes={EYE_MIND: 30_000.0, MIND_ARM: 1.0})
    # 20 ms each way, the link's jitter of a quarter of that, and 30 ms for 30 kB
    assert chain.median == pytest.approx(0.015 + 2 * 0.025 + 0.03, rel=0.15)
    assert chain.slowest == "mind"


def test_what_shares_a_computer_takes_longer_there(robot: Robot) -> None:
    """A hog that always runs leaves half of the CPU."""
    hog = ComponentModel(timers=(timer(0.01, 1.0),))
    models = {**PASSED_ON, "hog": hog}
    beside = predicted(robot, {**ALL_LEFT, "hog": "left"}, models)
    elsewhere = predicted(robot, {**ALL_LEFT, "hog": "right"}, models)
    assert elsewhere.median == pytest.approx(0.015, rel=0.1)
    assert beside.median == pytest.approx(0.03, rel=0.1)


def test_a_slow_computer_takes_longer(robot: Robot) -> None:
    slow = [replace(c, speed=0.5, address="10.0.0.1") for c in robot.computers]
    chain = predicted(replace(robot, computers=tuple(slow)))
    assert chain.median == pytest.approx(0.03, rel=0.1)


def test_an_emulated_computer_runs_quickly_and_then_stands(robot: Robot) -> None:
    """Of each 10 ms it runs for 5: what takes less does not stand."""
    short = {
        **PASSED_ON,
        "mind": ComponentModel(timers=(), takes={EYE_MIND: _sending(0.002, MIND_ARM)}),
        "arm": ComponentModel(timers=(), takes={MIND_ARM: _sending(0.001)}),
    }
    slow = [replace(c, speed=0.5) for c in robot.computers]
    emulated = replace(robot, computers=tuple(slow))
    real = [replace(c, address="10.0.0.1") for c in slow]
    assert predicted(emulated, models=short).median == pytest.approx(0.003, rel=0.15)
    chain = predicted(replace(robot, computers=tuple(real)), models=short)
    assert chain.median == pytest.approx(0.006, rel=0.15)


def test_timers_that_cannot_keep_their_deadlines_are_predicted(robot: Robot) -> None:
    hog = ComponentModel(timers=(timer(0.1, 0.12),))
    work = SimulatedWork(models={**PASSED_ON, "hog": hog})
    times = predict_times(robot, {**ALL_LEFT, "hog": "right"}, work)
    late = {each.component: each.late for each in times.timers}
    assert late["hog"] > 0.9
    assert late["eye"] == 0.0


def test_the_same_robot_has_the_same_prediction(robot: Robot) -> None:
    assert predicted(robot) == predicted(robot)


def test_a_chain_whose_data_never_comes_is_not_predicted(robot: Robot) -> None:
    silent = {**PASSED_ON, "eye": ComponentModel(timers=())}
    work = SimulatedWork(models=silent)
    times = predict_times(robot, ALL_LEFT, work)
    assert times.chains == ()
    assert times.unknown == ("see",)


def test_data_that_only_waits_for_cpu_is_as_old_as_the_simulation_is_long(
    robot: Robot,
) -> None:
    """On the right a run takes 20 s; 5 s are simulated."""
    left, right = robot.computers
    slow = replace(right, speed=0.0005, address="10.0.0.1")
    placement = {"eye": "left", "mind": "right", "arm": "left"}
    chain = predicted(replace(robot, computers=(left, slow)), placement)
    assert (chain.median, chain.p99, chain.late) == (5.0, 5.0, 1.0)
    assert chain.slowest == "mind"


def test_what_has_much_to_do_is_simulated_for_less(robot: Robot) -> None:
    left, right = robot.computers
    stuck = replace(robot, computers=(left, replace(right, speed=0.0005, address="a")))
    placement = {"eye": "left", "mind": "right", "arm": "left"}
    for rate, seconds in ((1e4, 5.0), (4e5, 1.0), (1e9, 0.2)):
        work = SimulatedWork(models=PASSED_ON, rate=rate)
        (chain,) = predict_times(stuck, placement, work).chains
        assert chain.median == pytest.approx(seconds)


def test_a_timer_that_skips_releases_does_not_keep_its_deadline(robot: Robot) -> None:
    """One run of twenty takes over a period, so that a release is skipped."""
    hog = ComponentModel(timers=(timer(0.1, 0.05),), factors=(1.0,) * 19 + (1.5,))
    often = ComponentModel(timers=(timer(0.1, 0.05),), factors=(1.0,) * 4 + (2.5,))
    for model, keeps in ((hog, True), (often, False)):
        work = SimulatedWork(models={**PASSED_ON, "hog": model})
        times = predict_times(robot, {**ALL_LEFT, "hog": "right"}, work)
        (found,) = (each for each in times.timers if each.component == "hog")
        assert (found.p99 < found.deadline) is keeps
