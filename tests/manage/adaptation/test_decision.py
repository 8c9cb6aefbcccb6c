"""Whether another placement is worth its moves."""

from __future__ import annotations

import re
from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from poise.estimate.online import Drift, Estimate
from poise.manage.adaptation.decision import decide, with_bursts
from poise.manage.adaptation.policy_values import values_of
from poise.manage.adaptation.situation import Situation
from poise.manage.migration.transition_plan import missing_cpu
from poise.manage.observe.chains import ChainAge
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.model.policy import ComputerValues
from poise.model.robot import (
    Action,
    Architecture,
    Chain,
    ComponentEntry,
    Computer,
    Link,
    Robot,
    Task,
)
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerStatus,
)
from tests.manage.adaptation.conftest import Make


def test_what_a_background_load_takes_away_makes_a_component_move(
    situation: Make,
) -> None:
    """Other programs get 0.2 of 0.5 cores: 0.3 are left, with the headroom of 5 %."""
    found = decide(situation(background={"left": 0.2}))
    assert found.acts
    assert found.proposal is not None
    assert len(found.proposal.steps) == 1
    assert found.gain == pytest.approx(0.4 - 0.3 * 1.05, abs=0.02)  # and margins
    assert found.cost == pytest.approx(0.3 + 0.2 * 0.05)
    assert re.fullmatch(
        r"1 step: 0\.09\d+ cores of work more, for 0\.31 core-seconds", found.why
    )


def test_nothing_moves_to_a_computer_that_the_manager_does_not_reach(
    situation: Make,
) -> None:
    """What runs there goes on, for another agent hears it."""
    seen = situation(background={"left": 0.2})
    assert not decide(replace(seen, away=frozenset({"right"}))).acts


def test_a_move_that_paused_its_component_for_long_is_not_worth_it(
    situation: Make,
) -> None:
    seen = situation(background={"left": 0.2})
    found = decide(replace(seen, downtimes={"a": 60.0, "b": 60.0}))
    assert not found.acts
    assert found.why.startswith("it stays as it is: 1 step: ")
    assert found.why.endswith("for 12.30 core-seconds, not worth it")


APART = {"a": "left", "b": "right"}


def test_when_all_fits_another_placement_does_not_help(situation: Make) -> None:
    found = decide(situation(missed=("a",)))
    assert not found.acts
    assert (
        "all components have the CPU that they need where they are: no placement is"
        in found.why
    )
    busy = decide(situation(APART, background={"right": 0.1}, missed=("a",)))
    assert (
        "all components have the CPU that they need where they are, beside other "
        "programs, which take 0.1 cores of 'right': no placement is known to help"
    ) in busy.why


def test_what_is_starved_is_not_said_to_have_the_cpu_that_it_needs(
    situation: Make,
) -> None:
    estimate = Estimate(mean=0.01, p95=0.01, error=0.001, starved=0.59)
    starved = DemandEstimate(
        component="a", computer="left", expected=None, estimate=estimate
    )
    found = decide(replace(situation(missed=("a",)), demand_estimates=(starved,)))
    assert not found.acts
    assert "all components have the CPU" not in found.why
    assert "'a' does not do 59% of its work, but by what is known of" in found.why


def test_what_was_starved_when_it_was_stopped_is_not_starved_now(
    situation: Make,
) -> None:
    estimate = Estimate(mean=0.01, p95=0.01, error=0.001, starved=0.59)
    starved = DemandEstimate(
        component="b", computer="left", expected=None, estimate=estimate
    )
    seen = situation({"a": "left"}, missed=("a",))
    seen = replace(seen, demand_estimates=(starved,))
    assert "'b'" not in decide(seen).why
    left, _ = values_of(seen, "computer")
    assert isinstance(left, ComputerValues)
    assert left.starved == 0.0


def crowded(situation: Make, takes: float) -> Situation:
    """Return a and b of 0.24 on 0.5 cores, late, with runs that take so long [s]."""
    seen = situation(robot=robot_of({"a": 0.24, "b": 0.24}), missed=("a", "b"))
    demands = tuple(
        DemandEstimate(
            component=name,
            computer="left",
            expected=None,
            estimate=Estimate(mean=0.24, p95=0.24, error=0.002),
        )
        for name in ("a", "b")
    )
    misses = tuple(replace(timer, takes=takes) for timer in seen.misses)
    return replace(seen, demand_estimates=demands, misses=misses)


def test_what_is_late_on_a_crowded_computer_moves_though_its_demand_fits(
    situation: Make,
) -> None:
    """0.48 of 0.5 cores are used, and runs take 106 ms of the 100 ms they have."""
    found = decide(crowded(situation, takes=0.106))
    assert found.acts
    assert found.proposal is not None
    assert len({*found.proposal.placement.values()}) == 2
    needs = found.proposal.shifted["a"]
    assert needs.mean == 0.24  # as `poise status` shows
    assert needs.counted > 0.24


def test_what_is_late_for_another_reason_stays_on_a_crowded_computer(
    situation: Make,
) -> None:
    """Its runs take 30 ms of the 100 ms they have: a deadline is missed elsewhere."""
    assert not decide(crowded(situation, takes=0.03)).acts


@pytest.mark.parametrize("is_full", [True, False])
def test_a_burst_that_fills_the_computer_of_what_is_late_counts(
    situation: Make, *, is_full: bool
) -> None:
    """In the mean 0.2 cores fit beside 0.2; now one takes 0.35."""
    seen = situation(missed=("a",))
    uses = {"a": 0.15, "b": 0.35} if is_full else {"a": 0.2, "b": 0.2}
    left = Load(capacity=0.5, used=sum(uses.values()), components=uses)
    seen = replace(seen, loads={**seen.loads, "left": left})
    found = decide(seen)
    assert found.acts == is_full
    amounts = with_bursts(seen).amounts()
    assert (amounts["b"] > 0.2) == is_full  # it is thought about at once
    if is_full:
        assert found.proposal is not None
        assert len({*found.proposal.placement.values()}) == 2
        assert str(found.proposal.shifted["b"]).startswith("35.0% ± 0.0% of a core")


def test_nothing_is_suspended_for_a_burst(situation: Make, two: Robot) -> None:
    """It is over soon, but the state of what is suspended is lost."""
    (both,) = two.architectures
    apart = [
        replace(both, name=c.name, function=c.name, priority=rank, components=(c,))
        for rank, c in enumerate(both.components)
    ]
    task = Task(name="work", actions=(Action(name="w", functions=("a", "b")),))
    robot = replace(two, architectures=apart, tasks=(task,))
    robot = replace(robot, computers=robot.computers[:1])
    seen = situation(robot=robot, missed=("b",))
    uses = Load(capacity=0.5, used=0.5, components={"a": 0.35, "b": 0.15})
    found = decide(replace(seen, loads={"left": uses}))
    assert not found.acts
    assert found.undone > 0.0


def test_what_an_idle_copy_uses_is_no_burst_of_its_component(situation: Make) -> None:
    """As while it is prepared for a move."""
    seen = situation(APART, missed=("a",))
    uses = Load(capacity=0.5, used=0.5, components={"a": 0.15, "b": 0.35})
    assert with_bursts(replace(seen, loads={"left": uses})).amounts()["b"] == 0.2


def test_what_is_lost_with_its_computer_is_named_where_nothing_helps(
    situation: Make,
) -> None:
    robot = robot_of({"a": 0.1, "eye": 0.1}, computers=3).with_components(
        lambda c: replace(c, only=("c2",)) if c.name == "eye" else c
    )
    seen = situation({"a": "left", "eye": "c2"}, robot=robot, missed=("a",))
    found = decide(replace(seen, lost=frozenset({"c2"})))
    assert not found.acts
    assert "blocked" not in found.why
    assert found.why.endswith(
        "Lost with their computers: 'eye' of 'c2'; components that need them wait"
    )


def test_what_needs_more_than_any_computer_has_is_not_said_to_have_it(
    situation: Make,
) -> None:
    need = DemandEstimate(
        component="a",
        computer="left",
        expected=0.2,
        estimate=Estimate(
            mean=0.9, p95=0.9, error=0.01, starved=0.6, drift=Drift(1.0, 0.2, 0.9)
        ),
    )
    seen = situation({"a": "left", "b": "right"}, missed=("a",))
    found = decide(replace(seen, demand_estimates=(need,)))
    assert not found.acts
    assert "'a' needs 90.0% ± 1.0% of a core now" in found.why
    assert "all that any computer can give it" in found.why
    assert "have the CPU" not in found.why


def test_when_nothing_fits_it_says_what_is_missing(situation: Make) -> None:
    full = situation(background={"left": 0.5, "right": 0.5}, missed=("a",))
    found = decide(full)
    assert not found.acts
    assert found.why.startswith(
        "no placement can help: timer 'tick' of component 'a' must end within 100 ms, "
        "and its runs take 30 ms (p99); 0.4 cores on 'left' are missing; "
    )
    assert (
        "components need 0.4 cores in all; after other programs and reserves "
        "'left' has 0 cores, 'right' has 0 cores"
    ) in found.why


def test_what_mends_a_part_is_done(situation: Make) -> None:
    """A and b of 0.27, c of 0.4 beside each other on 0.5: one move leaves 0.04."""
    needs = {"a": 0.27, "b": 0.27, "c": 0.40}
    robot = robot_of(needs)
    seen = replace(
        situation(dict.fromkeys(needs, "left"), robot=robot), demand_estimates=()
    )
    found = decide(seen)
    assert found.acts
    assert found.proposal is not None
    assert [step.component for step in found.proposal.steps] == ["c"]
    assert found.gain == pytest.approx(0.94 - 0.525 - (0.54 - 0.525), abs=0.05)


def test_where_one_move_mends_all_no_other_is_made(situation: Make) -> None:
    """Two moves would balance better, 0.4 on each computer, and do no work more."""
    left, right = {"a": 0.3, "b": 0.1, "c": 0.1, "d": 0.06}, {"e": 0.2, "f": 0.04}
    placed = dict.fromkeys(left, "left") | dict.fromkeys(right, "right")
    seen = situation(placed, robot=robot_of(left | right))
    found = decide(replace(seen, demand_estimates=()))
    assert found.acts
    assert found.proposal is not None
    (step,) = found.proposal.steps
    assert step.source == "left"


def test_a_computer_that_is_lost_with_what_is_pinned_there_stops_no_decision(
    situation: Make,
) -> None:
    robot = robot_of({"a": 0.4, "b": 0.4, "c": 0.1}, computers=3).with_components(
        lambda c: replace(c, only=("c2",)) if c.name == "c" else c
    )
    placed = {"a": "left", "b": "left", "c": "c2"}
    seen = replace(situation(placed, robot=robot), demand_estimates=())
    found = decide(replace(seen, lost=frozenset({"c2"})))
    assert found.acts


def test_a_function_that_is_lost_with_its_computer_stops_no_decision(
    situation: Make,
) -> None:
    """All of an architecture is pinned to the lost computer, and missing."""
    robot = robot_of({"a": 0.4, "b": 0.4}, computers=3)
    camera = Architecture(
        name="camera",
        function="camera",
        components=(ComponentEntry(name="c", demand={"cpu": 0.1}, only=("c2",)),),
    )
    asks = Action(name="w", functions=("all", "camera"))
    robot = replace(
        robot,
        architectures=(*robot.architectures, camera),
        tasks=(Task(name="work", actions=(asks,)),),
    )
    placed = {"a": "left", "b": "left", "c": "c2"}
    seen = replace(situation(placed, robot=robot), demand_estimates=())
    found = decide(replace(seen, lost=frozenset({"c2"})))
    assert found.acts, found.why


def robot_of(needs: Mapping[str, float], computers: int = 2) -> Robot:
    """Return components on computers of half a core."""
    names = ("left", "right", "c2")[:computers]
    parts = tuple(ComponentEntry(name=n, demand={"cpu": x}) for n, x in needs.items())
    return Robot(
        name="some",
        computers=tuple(Computer(name=name, capacity={"cpu": 0.5}) for name in names),
        architectures=(Architecture(name="all", function="all", components=parts),),
        tasks=(Task(name="work", actions=(Action(name="w", functions=("all",)),)),),
    )


def test_what_is_reserved_is_no_room(two: Robot) -> None:
    computers = tuple(replace(c, reserve={"cpu": 0.5}) for c in two.computers)
    robot = replace(two, computers=computers)
    both = {"a": "left", "b": "left"}
    missing = sum(missing_cpu(robot, both).values())
    assert missing == pytest.approx(0.4 - 0.25)


LATE = ChainAge(
    chain="c",
    deadline=0.1,
    used=10,
    missed=10,
    seconds=1.0,
    ages={"a": 0.0, "b": 0.35},
    wires={"a": 0.0, "b": 0.3},
    computers={"a": "left", "b": "right"},
)
"""0.3 of its 0.35 s are on the wire from `a` to `b`."""


def with_chain(situation: Situation, chain: ChainAge) -> Situation:
    """Return the situation of a robot that has a chain."""
    declared = Chain(
        name=chain.chain, through=tuple(chain.ages), deadline=chain.deadline
    )
    robot = replace(situation.robot, chains=(declared,))
    return replace(situation, robot=robot, chains=(chain,))


def test_a_chain_that_loses_its_time_on_a_wire_is_brought_together(
    situation: Make,
) -> None:
    found = decide(with_chain(situation({"a": "left", "b": "right"}), LATE))
    assert found.acts
    assert found.proposal is not None
    assert len(set(found.proposal.placement.values())) == 1
    assert found.gain == pytest.approx(0.2 + 0.2)


def test_a_chain_that_is_slow_off_the_wire_is_explained(situation: Make) -> None:
    slow = replace(LATE, wires={"a": 0.0, "b": 0.05})
    found = decide(with_chain(situation(), slow))
    assert not found.acts
    assert found.why.startswith(
        "the data of chain 'c' must not be older than 100 ms and is 350 ms old "
        "(a -> b 350 ms); what arrived was under way for 50 ms; "
    )


def test_data_that_is_late_at_times_is_said_to_be(situation: Make) -> None:
    at_times = replace(LATE, ages={"a": 0.0, "b": 0.067}, used=9, missed=2)
    found = decide(with_chain(situation(), at_times))
    assert found.why.startswith(
        "the data of chain 'c' must not be older than 100 ms and was older at 2 of 9 "
        "uses, and in the mean is 67 ms old (a -> b 67 ms)"
    )


def test_data_that_did_not_arrive_is_not_said_to_be_slow_off_the_wire(
    situation: Make,
) -> None:
    """A timer of `b` used old data while the link was cut: 0.9 s, and 2 ms before."""
    cut = replace(LATE, ages={"a": 0.0, "b": 0.9}, wires={"a": 0.0, "b": 0.0})
    found = decide(with_chain(situation(), cut))
    assert "b 900 ms); all components have the CPU that they need" in found.why
    assert "no placement is known to help" in found.why
    cut = replace(cut, wires={"a": 0.0, "b": 0.002})
    found = decide(with_chain(situation(), cut))
    assert "one computer" not in found.why
    assert "is 900 ms old (a -> b 900 ms); what arrived was under way for 2" in (
        found.why
    )
    assert "a link is cut" in found.why


def test_what_is_short_of_cpu_does_not_go_where_a_chain_would_be_late(
    situation: Make,
) -> None:
    """Without the chain it is `a` that goes: it is the quickest to start."""
    needs = {"a": 0.3, "b": 0.1, "c": 0.31}
    robot = replace(
        robot_of(needs), links=(Link(between=("left", "right"), latency=0.2),)
    )
    placed = dict.fromkeys(needs, "left")
    seen = replace(situation(placed, robot=robot), demand_estimates=())
    chain = replace(
        LATE,
        missed=0,
        ages={"a": 0.0, "b": 0.05},
        wires={"a": 0.0, "b": 0.0},
        computers={"a": "left", "b": "left"},
    )
    without, found = decide(seen), decide(with_chain(seen, chain))
    assert without.proposal is not None
    assert [step.component for step in without.proposal.steps] == ["a"]
    assert found.proposal is not None
    assert [step.component for step in found.proposal.steps] == ["c"]


def test_a_measured_start_counts_instead_of_an_assumed_one(situation: Make) -> None:
    seen = situation(background={"left": 0.2})
    started = tuple(
        ComponentStatus(name=name, state="active", start=2.0) for name in ("a", "b")
    )
    container = ContainerStatus(name="all", pid=1, components=started)
    agent = AgentStatus(
        computer="left", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    found = decide(replace(seen, statuses={"left": agent}))
    assert found.cost == pytest.approx(2.0 + 0.2 * 0.05)


def test_nothing_moves_to_a_lost_computer(situation: Make) -> None:
    seen = replace(situation(background={"left": 0.2}), lost=frozenset({"right"}))
    found = decide(seen)
    assert not found.acts


def test_what_is_on_a_lost_computer_does_not_count(situation: Make) -> None:
    placed = {"a": "left", "b": "right"}
    seen = situation(placed, background={"left": 0.3})
    found = decide(replace(seen, lost=frozenset({"right"})))
    assert not found.acts


def test_what_is_undone_counts_where_nothing_fits(situation: Make, two: Robot) -> None:
    """0.4 cores are needed of 0.3 with the headroom of 5 %; memory fits nowhere."""
    seen = situation(background={"left": 0.2})
    known = decide(seen)
    robot = replace(
        two.with_components(lambda c: replace(c, demand={**c.demand, "memory": 7.0})),
        computers=tuple(
            replace(c, capacity={**c.capacity, "memory": 5.0}) for c in two.computers
        ),
    )
    found = decide(replace(seen, robot=robot))
    assert not found.acts
    assert found.proposal is None
    assert found.undone == pytest.approx(known.undone)
    assert found.undone > 0.08


@pytest.mark.parametrize(("starved", "acts"), [("abc", True), ("a", False)])
def test_what_is_undone_counts_where_something_is_suspended(
    two: Robot, starved: str, *, acts: bool
) -> None:
    """Three of 0.4 cores on two computers of 0.5: the higher two do not get theirs.

    The one on the other computer would get no more without the lowest.
    """

    def architecture(name: str, priority: int, *components: str) -> Architecture:
        parts = [ComponentEntry(name=n, demand={"cpu": 0.4}) for n in components]
        return Architecture(
            name=name, function=name, priority=priority, components=tuple(parts)
        )

    robot = replace(
        two,
        architectures=(architecture("hi", 1, "a", "b"), architecture("lo", 0, "c")),
        tasks=(Task(name="work", actions=(Action(name="w", functions=("hi", "lo")),)),),
    )
    placement = {"a": "left", "b": "right", "c": "right"}
    well = Estimate(mean=0.4, p95=0.4, error=0.01)
    short = replace(well, starved=0.5)
    found = decide(
        Situation(
            robot=robot,
            placement=placement,
            demand_estimates=tuple(
                DemandEstimate(
                    component=n,
                    computer=at,
                    expected=None,
                    estimate=short if n in starved else well,
                )
                for n, at in placement.items()
            ),
        )
    )
    assert found.acts == acts
    assert (found.why == "not all fits without 'lo' (priority 0)") == acts
    assert found.undone > 0.25
