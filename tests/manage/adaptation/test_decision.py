"""Whether another placement is worth its moves."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.adaptation.decision import decide
from poise.manage.migration.residue import missing_cpu
from poise.manage.observe.chains import ChainAge
from poise.model.robot import Robot
from poise.wire.records.status import AgentStatus, ComponentStatus, ContainerStatus
from tests.manage.adaptation.conftest import Make


def test_what_a_background_load_takes_away_makes_a_component_move(
    situation: Make,
) -> None:
    """Other programs get 0.2 of 0.5 cores, and want half as much again."""
    found = decide(situation(background={"left": 0.2}))
    assert found.acts
    assert found.proposal is not None
    assert len(found.proposal.steps) == 1
    assert found.gain == pytest.approx(0.2 * 30)
    assert found.cost == pytest.approx(0.3 + 0.2 * 0.05)
    assert found.why == ("1 step: cost 0.31 core-seconds, gain 6.00 within 30 s")


def test_a_move_that_paused_its_component_for_long_is_not_worth_it(
    situation: Make,
) -> None:
    seen = situation(background={"left": 0.2})
    found = decide(replace(seen, downtimes={"a": 60.0, "b": 60.0}))
    assert not found.acts
    assert found.cost > found.gain
    assert found.why.startswith("it stays as it is: ")


def test_when_all_fits_another_placement_does_not_help(situation: Make) -> None:
    found = decide(situation(missed=("a",)))
    assert not found.acts
    assert "all components fit where they are" in found.why


def test_when_nothing_fits_it_says_what_is_missing(situation: Make) -> None:
    full = situation(background={"left": 0.45, "right": 0.45}, missed=("a",))
    found = decide(full)
    assert not found.acts
    assert found.why.startswith(
        "no placement can help: timer 'tick' of component 'a' must end within 100 ms, "
        "and its runs take 30 ms (p99); task 'work' has no placement any more"
    )
    assert (
        "they need 0.4 cores in all, and beside other programs and reserves 'left' has "
        "0 cores, 'right' has 0.05 cores"
    ) in found.why


def test_a_component_does_not_go_where_it_is_barred(situation: Make) -> None:
    found = decide(situation(background={"left": 0.2}), {"a": {"right"}})
    assert found.proposal is not None
    assert found.proposal.placement == {"a": "left", "b": "right"}


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


def test_a_chain_that_loses_its_time_on_a_wire_is_brought_together(
    situation: Make,
) -> None:
    apart = situation({"a": "left", "b": "right"})
    found = decide(replace(apart, chains=(LATE,)))
    assert found.acts
    assert found.proposal is not None
    assert len(set(found.proposal.placement.values())) == 1
    assert found.gain == pytest.approx((0.2 + 0.2) * 30)


def test_a_chain_that_is_slow_off_the_wire_is_explained(situation: Make) -> None:
    slow = replace(LATE, wires={"a": 0.0, "b": 0.05})
    found = decide(replace(situation(), chains=(slow,)))
    assert not found.acts
    assert found.why.startswith(
        "the data of chain 'c' must not be older than 100 ms and is 350 ms old, 300 ms "
        "if all of the chain were on one computer (a -> b 350 ms); "
    )


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
