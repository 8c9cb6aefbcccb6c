"""What makes the loop act, and what does not."""

from __future__ import annotations

from functools import partial

import msgspec
import pytest

from poise.estimate.online import Drift, Estimate
from poise.manage.adaptation.policies import Policies, Symptom
from poise.manage.adaptation.policy_values import values_of
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.chains import ChainAge
from poise.model.policy import SUBJECTS, Policy, Subject, shipped
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    ContainerStatus,
    State,
)
from tests.manage.adaptation.conftest import Make


def seen(situation: Situation, *names: str) -> list[str]:
    """Return what the shipped policies of these names say at once."""
    policies = [
        msgspec.structs.replace(policy, lasts=0.0)
        for policy in shipped()
        if policy.name in names
    ]
    found = Policies(policies).evaluate(partial(values_of, situation), 0.0)
    return [symptom.what for symptom in found]


def test_a_full_computer_whose_components_are_late_is_overloaded(
    situation: Make,
) -> None:
    loaded = situation(background={"left": 0.2}, missed=("a",))
    (found,) = seen(loaded, "overload")
    assert found == (
        "computer 'left' is overloaded: 0.5 cores of 0.5 cores are used: other "
        "programs take 0.2 cores there"
    )


def test_a_full_computer_that_keeps_its_deadlines_is_not(situation: Make) -> None:
    assert not seen(situation(background={"left": 0.2}), "overload")


def test_a_late_component_on_an_idle_computer_is_no_overload(situation: Make) -> None:
    assert not seen(situation(missed=("a",)), "overload")


def test_a_timer_that_misses_deadlines_is_named(situation: Make) -> None:
    assert seen(situation(missed=("b",)), "deadlines") == [
        "timer 'tick' of component 'b' on 'left' missed 5 of 10 deadlines within 1 s"
    ]


def test_a_drift_is_named_when_it_takes_a_reserve(situation: Make) -> None:
    """Both components on `left` drift to 0.3 of its 0.5 cores."""
    grown = tuple(
        msgspec.structs.replace(
            each,
            estimate=Estimate(
                mean=0.3,
                p95=0.3,
                error=0.0,
                drift=Drift(before=0.2, after=0.3, at=0.0),
            ),
        )
        for each in situation().demand_estimates
    )
    drifted = msgspec.structs.replace(situation(), demand_estimates=grown)
    (found,) = seen(drifted, "drift")
    assert found == (
        "the components on 'left' need 0.13 cores more than it has beside other "
        "programs and its reserve: the demand of 2 of them has changed"
    )
    alone = msgspec.structs.replace(drifted, placement={"a": "left", "b": "right"})
    assert not seen(alone, "drift")


OLD = ChainAge(
    chain="c",
    deadline=0.1,
    used=10,
    missed=8,
    seconds=1.0,
    ages={"eye": 0.0, "a": 0.01, "b": 0.3},
    wires={"eye": 0.0, "a": 0.0, "b": 0.25},
    computers={"eye": "left", "a": "left", "b": "right"},
)


def test_a_chain_says_which_step_takes_how_long(situation: Make) -> None:
    late = msgspec.structs.replace(situation(), chains=(OLD,))
    (found,) = seen(late, "chains")
    assert found == (
        "the data of chain 'c' was older than 100 ms at 8 of 10 uses by 'b' within 1 "
        "s: eye -> a 10 ms, a -> b 290 ms"
    )


def test_a_chain_that_was_late_once_is_not_named(situation: Make) -> None:
    once = msgspec.structs.replace(OLD, missed=1)
    assert not seen(msgspec.structs.replace(situation(), chains=(once,)), "chains")


def test_a_lost_computer_is_named(situation: Make) -> None:
    lost = msgspec.structs.replace(situation(), lost=frozenset({"right"}))
    assert seen(lost, "lost-computer") == ["computer 'right' is out of reach"]


def test_nothing_is_said_of_how_a_lost_computer_was(situation: Make) -> None:
    """Neither what it used, nor that it uses nothing now."""
    before = situation({"a": "left", "b": "right"}, background={"right": 0.3})
    estimates = tuple(
        msgspec.structs.replace(
            each, estimate=msgspec.structs.replace(each.estimate, starved=0.5)
        )
        for each in before.demand_estimates
    )
    health = ContainerHealth(name="all", state="running", since=0.0, cpu=0.2)
    status = AgentStatus(
        computer="right", generation=1, uptime=1.0, cpu=1.0, memory=9, health=(health,)
    )
    before = msgspec.structs.replace(
        before, demand_estimates=estimates, statuses={"right": status}
    )
    asked: tuple[tuple[Subject, str, str], ...] = (
        ("computer", "used >= 0.5 or used < 0.1", "{name} uses {used}"),
        ("computer", "starved >= 50% or starved == 0", "{name}: {starved}"),
        ("computer", "memory > 0 B", "{name} takes {memory}"),
        ("component", "starved > 40%", "{name} on {computer}: {starved}"),
        ("component", "state == 'gone'", "{name} is gone: {starved}"),
        ("container", "cpu > 0.1", "{name} takes {cpu}"),
        ("robot", "used > 0", "{name} uses {used}"),
    )
    policies = Policies(
        Policy(name=f"p{n}", for_each=subject, when=when, do="notify", say=say)
        for n, (subject, when, say) in enumerate(asked)
    )
    look(policies, before, 0.0)
    assert [symptom.what for symptom in look(policies, before, 1.0)] == [
        "right uses 0.5 cores",
        "left: 50%",
        "right: 50%",
        "right takes 9 B",
        "a on left: 50%",
        "b on right: 50%",
        "a is gone: 50%",
        "b is gone: 50%",
        "all takes 0.2 cores",
        "two uses 0.7 cores",
    ]
    lost = msgspec.structs.replace(before, lost=frozenset({"right"}))
    look(policies, lost, 2.0)
    assert [symptom.what for symptom in look(policies, lost, 3.0)] == [
        "left: 50%",
        "a on left: 50%",
        "a is gone: 50%",
        "b is gone: unknown",
        "two uses 0.2 cores",
    ]


LATE = Policy(name="p", for_each="timer", when="late", do="replan", say="{name}")


def look(policies: Policies, situation: Situation, now: float) -> tuple[Symptom, ...]:
    """Look once."""
    return policies.evaluate(partial(values_of, situation), now)


def test_only_what_lasts_counts(situation: Make) -> None:
    policies, late, well = Policies([LATE]), situation(missed=("a",)), situation()
    assert not look(policies, late, 10.0)
    assert not look(policies, late, 10.4)
    (found,) = look(policies, late, 10.5)
    assert found.computer == "left"
    assert not look(policies, well, 10.6)
    assert not policies.since
    assert not look(policies, late, 10.7)  # it begins again


def test_what_is_not_reported_for_a_moment_goes_on(situation: Make) -> None:
    """After each change of what should run, a computer's next status is waited for."""
    policies, late, gone = Policies([LATE]), situation(missed=("a",)), situation()
    gone = msgspec.structs.replace(gone, misses=())
    assert not look(policies, late, 10.0)
    read = partial(values_of, gone)
    assert not policies.evaluate(read, 10.2, lacks_some=True)
    assert look(policies, late, 10.6)
    assert not policies.evaluate(read, 15.5, lacks_some=True)
    assert policies.since
    policies.evaluate(read, 15.7, lacks_some=True)
    assert not policies.since
    assert not look(policies, late, 16.0)
    timers = [msgspec.structs.replace(timer, late=False) for timer in late.misses]
    well = msgspec.structs.replace(late, misses=tuple(timers))
    policies.evaluate(partial(values_of, well), 16.2, lacks_some=True)
    assert not policies.since  # it is reported, and in time


def test_what_a_function_wants_no_more_ends_at_once(situation: Make) -> None:
    """Whatever else is reported: it has seen what there is."""
    policies, wanted = Policies([LATE]), ("own", "a", "left", "move")
    policies.since, policies._seen_at = {wanted: 9.0}, {wanted: 9.9}
    policies.evaluate(partial(values_of, situation()), 10.0, lacks_some=True)
    assert not policies.since


def test_nothing_is_done_again_until_it_has_cooled_down(situation: Make) -> None:
    policy = msgspec.structs.replace(LATE, lasts=0.0, cool_down=60.0)
    policies, late = Policies([policy]), situation(missed=("a", "b"))
    first, second = look(policies, late, 0.0)
    assert policies.due((first, second), 0.0) == (first, second)
    policies.note_acted([first], 0.0)
    assert policies.due((first, second), 59.0) == (second,)
    assert policies.due((first, second), 60.0) == (first, second)


def test_what_is_off_says_nothing(situation: Make) -> None:
    off = msgspec.structs.replace(LATE, lasts=0.0, off=True)
    assert not look(Policies([off]), situation(missed=("a",)), 0.0)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_subject_has_values_of_its_record(
    situation: Make, subject: Subject
) -> None:
    late = msgspec.structs.replace(situation(missed=("a",)), chains=(OLD,))
    for values in values_of(late, subject):
        assert isinstance(values, SUBJECTS[subject])
        assert msgspec.convert(msgspec.to_builtins(values), SUBJECTS[subject]) == values


def growing(situation: Situation, state: State, full_in: float) -> Situation:
    """Return the situation with a container on `left` that grows by 1 MiB a second."""
    components = tuple(ComponentStatus(name=n, state=state) for n in ("a", "b"))
    container = ContainerStatus(name="all", pid=1, components=components)
    health = ContainerHealth(
        name="all",
        state="running",
        since=0.0,
        memory=100 << 20,
        growth=1 << 20,
        limit=128 << 20,
        full_in=full_in,
    )
    status = AgentStatus(
        computer="left",
        generation=1,
        uptime=1.0,
        cpu=1.0,
        containers=(container,),
        health=(health,),
    )
    return msgspec.structs.replace(situation, statuses={"left": status})


def test_a_container_that_will_be_killed_within_a_minute_is_named(
    situation: Make,
) -> None:
    (found,) = seen(growing(situation(), "active", 28.0), "memory-leak")
    assert found == (
        "container 'all' on 'left' (a, b) takes 100 MiB, 0 B were expected, and 1 MiB "
        "more each second: the limit of 128 MiB is reached in 28 s"
    )


def test_a_container_that_grows_slowly_or_starts_is_not(situation: Make) -> None:
    assert not seen(growing(situation(), "active", 61.0), "memory-leak")
    assert not seen(growing(situation(), "unconfigured", 28.0), "memory-leak")
