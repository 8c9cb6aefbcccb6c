"""A robot whose managers follow each other: any computer may die."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.emulate import probe_host
from tests.leader_kills.kills import Kills, Report
from tests.waiting import LONG

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(LONG)]


@pytest.fixture(autouse=True)
def own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def test_a_standby_leads_when_the_leaders_computer_dies(tmp_path: Path) -> None:
    with Kills(tmp_path) as kills:
        outcome = kills.kill(kills.leader())
        assert outcome.was_leader
        assert outcome.lost
        kills.kill(next(name for name in "abc" if name != kills.leader()))
        assert not Report.of(kills).broken()


def test_with_a_witness_either_of_two_computers_may_die(tmp_path: Path) -> None:
    with Kills(tmp_path, with_witness=True) as kills:
        for _ in range(2):  # the second time nothing runs where the votes come from
            outcome = kills.kill(kills.leader())
            assert outcome.was_leader
            assert outcome.lost
        kills.kill("c")  # the witness
        assert not Report.of(kills).broken()


def test_the_side_of_a_cut_with_most_votes_goes_on(tmp_path: Path) -> None:
    with Kills(tmp_path) as kills:
        outcome = kills.kill(kills.leader(), fault="cut")
        assert outcome.lost
        kills.kill(kills.leader(), fault="flap")
        assert not Report.of(kills).broken()
