"""An agent obeys one manager at a time, and says whom."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.runtime.agent.fence import Fence
from poise.wire.records.request_records import Claim, Election, ManagerId, Refused

FIRST = ManagerId(key="f", user="ann", host="desk", pid=7, since=0.0, term=1)
SECOND = ManagerId(key="s", user="bob", host="robot", pid=7, since=0.0, term=2)
VOTED = Election(votes={"left": 1, "right": 1})


class Rig:
    """A fence that a first manager has claimed with token 5."""

    def __init__(self, election: Election | None = None) -> None:
        self.said: list[str] = []
        self.woken = 0
        self.now = 100.0
        self.election = election
        self.fence = Fence(
            "robot", "left", self._wake, self.said.append, wall=lambda: self.now
        )
        assert self.claim(FIRST, 5)
        self.fence.update()

    def _wake(self) -> None:
        self.woken += 1

    def claim(
        self,
        manager: ManagerId,
        token: int,
        *,
        take_over: bool = False,
        is_unheard: bool = False,
    ) -> bool:
        """Return whether a claim is accepted."""
        claim = Claim(manager, take_over, election=self.election)
        refused = self.fence.claim(claim, token, is_unheard=is_unheard)
        assert refused is None or isinstance(refused, Refused)
        return refused is None

    def lose(self, manager: ManagerId, *, has_ended: bool = False) -> None:
        """Let a manager's liveliness token go."""
        self.fence.note_liveliness(manager.key, is_there=False, has_ended=has_ended)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_claim_that_is_repeated_is_accepted_again_and_an_earlier_one_refused(
    rig: Rig,
) -> None:
    assert rig.claim(FIRST, 5)
    assert not rig.claim(FIRST, 4)
    assert rig.claim(FIRST, 6)


def test_another_manager_succeeds_one_that_is_gone_or_takes_over(rig: Rig) -> None:
    assert not rig.claim(SECOND, 6)
    assert not rig.claim(SECOND, 5, take_over=True)  # no new token
    rig.lose(FIRST)
    assert not rig.claim(SECOND, 5)
    assert rig.claim(SECOND, 6)
    assert rig.fence.manager == SECOND
    assert not rig.claim(FIRST, 7)
    assert rig.claim(FIRST, 7, take_over=True)


def test_who_is_voted_for_has_a_later_term_and_is_not_held_up_by_a_lost_token() -> None:
    rig = Rig(VOTED)
    rig.lose(FIRST)
    assert not rig.claim(SECOND, 6)  # a cut may have taken the token
    assert not rig.claim(replace(SECOND, term=1), 6, is_unheard=True)
    assert not rig.claim(SECOND, 5, is_unheard=True)
    assert rig.claim(SECOND, 6, is_unheard=True)
    rig.lose(SECOND, has_ended=True)
    assert rig.claim(replace(FIRST, term=3), 7)


def test_a_poll_changes_nothing(rig: Rig) -> None:
    poll = Claim(FIRST, is_poll=True)
    assert rig.fence.claim(poll, 8) is None
    assert rig.fence.token == 5


def test_obeys_only_the_token_of_the_last_claim(rig: Rig) -> None:
    assert not rig.fence.refusal(5)
    assert "managed by user ann" in rig.fence.refusal(4)
    assert "managed by user ann" in rig.fence.refusal(6)
    nobody = Fence("robot", "left", lambda: None, rig.said.append)
    assert "no manager has claimed 'left'" in nobody.refusal(0)


def test_once_cut_off_refuses_its_manager_until_that_claims_it_again(rig: Rig) -> None:
    rig.fence.cut()
    assert rig.woken == 1
    rig.fence.update()
    assert rig.fence.cut_off == 100.0
    assert "cut off from its manager" in rig.said[-1]
    for token in (5, rig.fence.token):
        assert "the lease of 'left' ended" in rig.fence.refusal(token)
    assert not rig.claim(FIRST, 5)
    assert rig.claim(FIRST, 7)
    assert not rig.fence.refusal(7)
    rig.fence.note_told()
    assert not rig.fence.is_cut_off
    assert rig.said[-1] == "reached by its manager again"


def test_the_first_moment_of_a_cut_counts(rig: Rig) -> None:
    rig.fence.cut()
    rig.fence.update()
    rig.now = 107.0
    rig.fence.update()
    rig.fence.lapse()
    assert rig.fence.cut_off == 100.0
    assert len([line for line in rig.said if "cut off" in line]) == 1


def test_says_once_that_its_manager_came_or_went(rig: Rig) -> None:
    assert rig.said == [f"managed by {FIRST}"]
    assert rig.fence.unmanaged == 0.0
    rig.fence.update()
    rig.now = 103.0
    rig.lose(FIRST)
    rig.fence.update()
    rig.now = 109.0
    rig.fence.update()
    assert rig.fence.unmanaged == 103.0
    assert rig.said[1:] == [f"{FIRST} is gone; what still runs here goes on"]
    rig.fence.note_liveliness("f", is_there=True, has_ended=False)
    rig.fence.update()
    assert rig.fence.unmanaged == 0.0
    assert rig.said[2:] == [f"managed by {FIRST}"]


def test_a_manager_that_may_be_cut_off_is_not_succeeded(rig: Rig) -> None:
    assert rig.fence.succeeds("f")
    assert not rig.fence.succeeds("s")
    rig.lose(FIRST)
    assert rig.fence.is_managed()
    assert not rig.fence.succeeds("s")
    rig.lose(FIRST, has_ended=True)
    assert not rig.fence.is_managed()
    assert rig.fence.succeeds("s")
    assert rig.woken == 1
    rig.fence.note_alive("f")  # it was heard since
    assert rig.fence.is_managed()
    rig.lose(FIRST, has_ended=True)
    rig.fence.note_liveliness("f", is_there=True, has_ended=False)
    assert rig.fence.is_managed()
    nobody = Fence("robot", "left", lambda: None, rig.said.append)
    assert not nobody.is_managed()
    assert nobody.succeeds("s")
