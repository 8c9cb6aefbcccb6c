"""Links that are cut or slow, as the agents at both ends see them."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.adaptation.policies import Policies
from poise.manage.adaptation.subjects import values_of
from poise.model.policy.shipped import policies_of
from poise.model.policy.values import LinkValues
from poise.model.robot import Link, Robot
from poise.wire.records.heartbeats import LinkQuality
from poise.wire.records.status import AgentStatus
from tests.manage.adaptation.conftest import Make


def quality(
    delay: float = 0.001, loss: float = 0.0, silent: float = 0.1
) -> LinkQuality:
    return LinkQuality(delay=delay, loss=loss, silent=silent)


def seen(facts: Make, robot: Robot, **links: LinkQuality) -> list[str]:
    """Return the policies that see something when `left` says this of its links."""
    linked = replace(robot, links=(Link(between=("left", "right"), latency=0.002),))
    left = AgentStatus(computer="left", generation=1, uptime=1.0, cpu=0.0, links=links)
    now = replace(facts(robot=linked), statuses={"left": left})
    policies = Policies(policies_of(linked))
    for at in (0.0, 5.0):
        found = policies.look(lambda subject: values_of(now, subject), at)
    return [symptom.policy.name for symptom in found]


def test_a_good_link_is_not_mentioned(facts: Make, two: Robot) -> None:
    assert seen(facts, two, right=quality()) == []


def test_nothing_is_known_of_a_link_without_heartbeats(facts: Make, two: Robot) -> None:
    assert seen(facts, two) == []


def test_a_link_over_which_nothing_comes_is_cut(facts: Make, two: Robot) -> None:
    assert seen(facts, two, right=quality(silent=1.0, loss=0.5)) == ["cut-link"]


@pytest.mark.parametrize("bad", [quality(delay=0.06), quality(loss=0.2)])
def test_a_link_with_delay_or_loss_is_slow(
    facts: Make, two: Robot, bad: LinkQuality
) -> None:
    assert seen(facts, two, right=bad) == ["slow-link"]


def test_a_link_to_a_lost_computer_is_no_news(facts: Make, two: Robot) -> None:
    robot = replace(two, links=(Link(between=("left", "right")),))
    left = AgentStatus(
        computer="left",
        generation=1,
        uptime=1.0,
        cpu=0.0,
        links={"right": quality(silent=9.0)},
    )
    now = replace(
        facts(robot=robot), statuses={"left": left}, lost=frozenset({"right"})
    )
    (link,) = values_of(now, "link")
    assert isinstance(link, LinkValues)
    assert not link.cut
