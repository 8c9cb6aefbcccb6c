"""Links that are cut or slow, as the agents at both ends see them."""

from __future__ import annotations

import re
from itertools import combinations

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.manage.adaptation.bad_links import check_links
from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.policies import Policies
from poise.manage.adaptation.policy_values import values_of
from poise.manage.adaptation.situation import Situation
from poise.manage.adaptation.when_to_act import MoveLimits
from poise.manage.observe.estimates import Load
from poise.model.policy import LinkValues, policies_of
from poise.model.robot import Computer, Connector, ConnectorEnd, Link, Robot
from poise.wire.records.heartbeat_records import LinkQuality
from poise.wire.records.status_records import AgentStatus
from tests.manage.adaptation.conftest import Make


def quality(
    delay: float = 0.001, loss: float = 0.0, silent: float = 0.1
) -> LinkQuality:
    return LinkQuality(delay=delay, loss=loss, silent=silent)


def seen(situation: Make, robot: Robot, **links: LinkQuality) -> list[str]:
    """Return the policies that see something when `left` says this of its links."""
    linked = replace(robot, links=(Link(between=("left", "right"), latency=0.002),))
    left = AgentStatus(computer="left", generation=1, uptime=1.0, cpu=0.0, links=links)
    now = replace(situation(robot=linked), statuses={"left": left})
    policies = Policies(policies_of(linked.policies))
    for at in (0.0, 5.0):
        found = policies.evaluate(lambda subject: values_of(now, subject), at)
    return [symptom.policy.name for symptom in found]


def test_a_good_link_is_not_mentioned(situation: Make, two: Robot) -> None:
    assert seen(situation, two, right=quality()) == []


def test_nothing_is_known_of_a_link_without_heartbeats(
    situation: Make, two: Robot
) -> None:
    assert seen(situation, two) == []


def test_a_link_over_which_nothing_comes_is_cut(situation: Make, two: Robot) -> None:
    assert seen(situation, two, right=quality(silent=1.0, loss=0.5)) == ["cut-link"]


@pytest.mark.parametrize("bad", [quality(delay=0.06), quality(loss=0.2)])
def test_a_link_with_delay_or_loss_is_slow(
    situation: Make, two: Robot, bad: LinkQuality
) -> None:
    assert seen(situation, two, right=bad) == ["slow-link"]


@pytest.mark.parametrize("gone", ["lost", "away"])
def test_a_link_to_an_unreached_computer_is_no_news(
    situation: Make, two: Robot, gone: str
) -> None:
    """Each agent that was replaced by another one had its links told to be cut."""
    robot = replace(two, links=(Link(between=("left", "right")),))
    left = AgentStatus(
        computer="left",
        generation=1,
        uptime=1.0,
        cpu=0.0,
        links={"right": quality(silent=9.0)},
    )
    now = replace(
        situation(robot=robot), statuses={"left": left}, **{gone: frozenset({"right"})}
    )
    (link,) = values_of(now, "link")
    assert isinstance(link, LinkValues)
    assert not link.cut


def joined(robot: Robot, *, third: bool = True, bandwidth: float = 1e6) -> Robot:
    """Return it with a connector between `a` and `b`, and a third computer."""
    names = ("left", "right", *(("middle",) if third else ()))
    ends = ConnectorEnd("a", "out"), ConnectorEnd("b", "in")
    return replace(
        robot,
        computers=tuple(Computer(name=name, capacity={"cpu": 0.5}) for name in names),
        connectors=(Connector(between=ends, message=100.0, rate=10.0),),
        links=tuple(
            Link(between=pair, bandwidth=bandwidth) for pair in combinations(names, 2)
        ),
    )


def over(situation: Make, robot: Robot, link: LinkQuality) -> Situation:
    """Return one where `a` and `b` are at the ends of a link that is planned for."""
    left = AgentStatus(
        computer="left", generation=1, uptime=1.0, cpu=0.0, links={"right": link}
    )
    return replace(
        situation({"a": "left", "b": "right"}, robot=robot),
        statuses={"left": left},
        bad_links=frozenset({"left-right"}),
    )


def test_one_end_of_a_cut_link_moves_to_where_both_are_reached(
    situation: Make, two: Robot
) -> None:
    """Nothing can move over the cut link itself; all they compute is in vain."""
    found = decide(over(situation, joined(two), quality(silent=1.0)))
    assert found.acts
    assert found.gain == pytest.approx(0.2 + 0.2)
    assert found.proposal is not None
    assert sorted(found.proposal.placement.values()) in (
        ["left", "middle"],
        ["middle", "right"],
    )
    assert found.why.startswith(
        "link 'left-right' is cut, and 'a.out-b.in' crosses it; 1 step: "
    )


def test_nothing_moves_when_there_is_no_way_round_a_cut_link(
    situation: Make, two: Robot
) -> None:
    alone = over(situation, joined(two, third=False), quality(silent=1.0))
    found = decide(alone)
    assert not found.acts
    assert found.why.startswith(
        "it stays as it is: link 'left-right' is cut, and 'a.out-b.in' crosses it; "
    )


def test_what_changes_nothing_gains_nothing(situation: Make, two: Robot) -> None:
    """The CPU that is short and the work in vain are no sum that rounds."""
    alone = over(situation, joined(two, third=False), quality(silent=1.0))
    busy = {"left": Load(capacity=0.5, used=0.5, background=0.4)}
    found = decide(replace(alone, loads={**alone.loads, **busy}))
    assert found.undone > 0.2 + 0.2
    assert found.gain == 0.0


@pytest.mark.parametrize(
    ("component", "source", "why"),
    [
        ("a", "left", "the component's state cannot cross it"),
        ("b", "middle", "'a.out-b.in' would cross it"),
    ],
)
def test_a_move_that_needs_a_cut_link_is_refused_at_once(
    situation: Make, two: Robot, component: str, source: str, why: str
) -> None:
    now = over(situation, joined(two), quality(silent=1.0))
    now = replace(now, placement={"a": "left", "b": "right", component: source})
    said = f"cannot move to 'right': link 'left-right' is cut: {why}"
    with pytest.raises(UsageError, match=re.escape(said)):
        check_links(now, component, "right")
    check_links(now, "a", "middle")


def test_over_a_slow_link_the_ends_meet_at_once(situation: Make, two: Robot) -> None:
    """Of a period of 100 ms 60 are lost."""
    slow = over(situation, joined(two, third=False), quality(delay=0.06))
    found = decide(slow)
    assert found.acts
    assert found.gain == pytest.approx(0.6 * (0.2 + 0.2))
    assert found.proposal is not None
    assert len(set(found.proposal.placement.values())) == 1
    assert len(found.proposal.steps) == 1


def test_what_nothing_crosses_changes_nothing(situation: Make, two: Robot) -> None:
    robot = replace(joined(two), connectors=())
    found = decide(over(situation, robot, quality(silent=1.0)))
    assert not found.acts
    assert found.why.startswith("link 'left-right' is cut; ")


def test_a_slow_link_that_costs_little_is_not_worth_a_move(
    situation: Make, two: Robot
) -> None:
    """0.3 s to start a component, against 0.002 x 0.4 cores x 30 s."""
    seen = over(situation, joined(two), quality(delay=0.0002))
    assert not decide(seen).acts


def test_another_link_that_is_cut_is_not_crossed_instead(
    situation: Make, two: Robot
) -> None:
    """`b` is held to `right`, and `a` cannot go there; `middle` reaches both."""
    (whole,) = two.architectures
    first, second = whole.components
    held = replace(whole, components=(first, replace(second, only=("right",))))
    robot = joined(replace(two, architectures=(held,)))
    found = decide(over(situation, robot, quality(silent=1.0)))
    assert found.acts
    assert found.proposal is not None
    assert found.proposal.placement == {"a": "middle", "b": "right"}


def test_a_link_that_comes_and_goes_moves_less_and_less(
    situation: Make, two: Robot
) -> None:
    """15 minutes: cut for 10 s in every 20 s."""
    robot, limits, moves = joined(two), MoveLimits(), []
    at: dict[str, str] = {"a": "left", "b": "right"}
    for now in range(900):
        if now % 20 < 10:
            limits.reset_backoff()
            continue
        seen = replace(
            over(situation, robot, quality(silent=1.0)),
            placement=at,
        )
        if limits.is_backing_off(now, seen.amounts()):
            continue
        found = decide(seen)
        if found.acts and found.proposal is not None:
            limits.note(found.proposal.steps, now)
            at = dict(found.proposal.placement)
            moves.append(now)
        else:
            limits.start_backoff(now, seen.amounts())
    assert len(moves) == 1
