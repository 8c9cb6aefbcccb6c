"""Of two managers of one robot, one gives way."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from poise.manage.agent_connections.claims import Claims, gives_way_to
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import Claimed, Election, ManagerId
from poise.wire.records.status_records import AgentStatus

EARLIER = ManagerId(key="e", user="ann", host="desk", pid=7, since=9.0, term=1)
LATER = ManagerId(key="l", user="bob", host="robot", pid=7, since=0.0, term=2)
"""The clock of its computer is behind."""
COMPUTERS = ("a", "b", "c")


def agent(
    computer: str, manager: ManagerId | None, token: int, unmanaged: float = 0.0
) -> AgentStatus:
    return AgentStatus(
        computer=computer,
        generation=1,
        uptime=9.0,
        cpu=0.1,
        manager=manager,
        token=token,
        unmanaged=unmanaged,
    )


def test_the_earlier_one_gives_way_where_each_has_some_agents() -> None:
    statuses = [agent("a", LATER, 3), agent("b", EARLIER, 2), agent("c", EARLIER, 2)]
    assert gives_way_to(EARLIER, {"b": 2, "c": 2}, {}, statuses) == LATER
    assert gives_way_to(LATER, {"a": 3}, {}, statuses) is None


def test_the_later_one_gives_way_when_no_agent_obeys_it_any_more() -> None:
    statuses = [agent(name, EARLIER, 4) for name in COMPUTERS]
    assert gives_way_to(LATER, {"a": 3}, {}, statuses) == EARLIER
    assert gives_way_to(EARLIER, dict.fromkeys(COMPUTERS, 4), {}, statuses) is None
    assert gives_way_to(LATER, {"a": 3}, {}, statuses[1:]) is None  # a may obey it


def test_nobody_gives_way_to_one_that_is_gone() -> None:
    statuses = [agent("a", LATER, 3, unmanaged=5.0), agent("b", None, 0)]
    assert gives_way_to(EARLIER, {"a": 2}, {"a": 1}, statuses) is None
    assert gives_way_to(EARLIER, {}, {}, statuses) is None


def test_one_that_does_not_know_what_another_told_gives_way_though_that_is_gone() -> (
    None
):
    """It was paused meanwhile, and would undo what the other one moved."""
    statuses = [agent("a", LATER, 3, unmanaged=5.0)]
    assert gives_way_to(EARLIER, {"a": 2}, {"a": 0}, statuses) == LATER


def test_one_that_was_replaced_before_it_told_anything_gives_way_too() -> None:
    """It knows what it found as it claimed the agent, and that the other told more."""
    claims = Claims(EARLIER, {}, None, is_leased=True)
    before = agent("a", None, 1)
    claims.new("a", before)
    claims.accept("a", Claimed(Deployment(generation=0, containers=())))
    assert claims.successor([agent("a", LATER, 3, unmanaged=5.0)]) == LATER
    claims.accept("a", Claimed(Deployment(generation=1, containers=())))
    assert claims.successor([agent("a", LATER, 3, unmanaged=5.0)]) is None


def test_a_status_from_before_its_own_claim_makes_none_give_way() -> None:
    assert gives_way_to(EARLIER, {"a": 3}, {}, [agent("a", LATER, 2)]) is None
    assert gives_way_to(EARLIER, {"a": 3}, {}, [agent("a", LATER, 3)]) is None


def test_none_gives_way_to_itself_where_an_answer_to_its_claim_was_lost() -> None:
    statuses = [agent("a", LATER, 4)]
    assert gives_way_to(LATER, {"a": 3}, {}, statuses) is None


def test_gives_way_to_the_last_of_several() -> None:
    third = replace(LATER, key="t", term=3)
    statuses = [agent("a", LATER, 3), agent("b", third, 3)]
    assert gives_way_to(EARLIER, {}, {}, statuses) == third
    assert gives_way_to(EARLIER, {}, {}, statuses[::-1]) == third


def test_one_that_has_claimed_nothing_does_not_give_way_to_an_earlier_one() -> None:
    assert gives_way_to(LATER, {}, {}, [agent("a", EARLIER, 2)]) is None


def test_an_agent_that_votes_refuses_all_earlier_terms_from_then_on() -> None:
    """So one that leads gives way, though the agent's token is no new one."""
    claims = Claims(EARLIER, {}, Election(votes={"a": 1, "b": 1}), is_leased=True)
    statuses = [agent("a", LATER, 1), agent("b", replace(LATER, key="t", term=3), 1)]
    claims.new("a", None)
    claims.accept("a", None)
    assert claims.successor([agent("a", EARLIER, 1)]) is None
    assert claims.successor([agent("a", replace(LATER, term=0), 1)]) is None
    assert claims.successor(statuses) == statuses[1].manager
    same_term = replace(LATER, term=1)
    assert claims.successor([agent("a", same_term, 1)]) == same_term


def test_each_claim_has_a_token_that_its_agent_has_not_seen() -> None:
    claims = Claims(LATER, {}, None, is_leased=True)
    claims.new("a", agent("a", EARLIER, 7))
    assert claims.tokens == {"a": 8}
    claims.new("a", agent("a", EARLIER, 5))  # an old status
    assert claims.tokens == {"a": 9}


def test_an_agent_is_obeyed_no_more_once_its_token_is_revoked() -> None:
    claims = Claims(LATER, {}, None, is_leased=True)
    claims.new("a", None)
    assert not claims.is_obeyed(agent("a", LATER, 1))  # it did not accept the claim
    claims.accept("a", None)
    assert claims.is_obeyed(agent("a", LATER, 1))
    assert not claims.is_obeyed(agent("a", EARLIER, 0))
    claims.revoke(["a"])
    revoked = claims.tokens["a"]
    for token in range(revoked + 1):
        assert not claims.is_obeyed(agent("a", LATER, token))
    claims.new("a", agent("a", LATER, 1))
    assert claims.tokens["a"] > revoked


def test_a_term_is_higher_than_all_that_agents_obeyed_and_stays() -> None:
    claims = Claims(replace(EARLIER, term=0), {}, None, is_leased=True)
    claims.begin_term([agent("a", None, 0)])
    assert claims.manager.term == 1
    claims.begin_term([agent("a", LATER, 1), agent("b", EARLIER, 1)])
    assert claims.manager.term == 3
    claims.new("a", None)
    claims.accept("a", None)
    claims.begin_term([agent("a", replace(LATER, term=7), 1)])
    assert claims.manager.term == 3


@given(st.tuples(*[st.booleans()] * 3), st.data())
def test_never_do_both(are_later: tuple[bool, ...], data: st.DataObject) -> None:
    """Whatever agents each of them sees, of those that it has claimed before too."""
    now = {
        name: agent(name, LATER if is_later else EARLIER, 5)
        for name, is_later in zip(COMPUTERS, are_later, strict=True)
    }

    def gives_way(manager: ManagerId) -> bool:
        seen = data.draw(st.sets(st.sampled_from(COMPUTERS)))
        lost = data.draw(st.sets(st.sampled_from(COMPUTERS)))
        mine = {name for name, each in now.items() if each.manager == manager}
        claimed = dict.fromkeys(lost, 4) | dict.fromkeys(mine, 5)
        return bool(gives_way_to(manager, claimed, {}, [now[n] for n in seen]))

    assert not (gives_way(EARLIER) and gives_way(LATER))
