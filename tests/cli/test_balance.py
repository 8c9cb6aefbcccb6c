"""What `poise balance` prints."""

from __future__ import annotations

import json
import math

import pytest
import typer

from poise.cli.running_robot_command import balance_command, move_command
from poise.errors import UsageError
from poise.manage.control_socket.commands import Rebalanced
from poise.manage.migration.migration_report import (
    MigrationReport,
    Proposal,
    TransitionReport,
    TransitionStep,
)
from poise.plan import Terms
from poise.session.running_robots.running import RolledBack, Running

WHY = "ValueError at\n    maps[name] = found[/tmp] + [i for i in rest]"


def test_why_it_was_called_off_is_told_as_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = (TransitionStep("eye", "a", "b"),)
    terms = Terms(total=0.5, communication=0.0, balance=0.5)
    proposal = Proposal(
        shifted={}, now=terms, then=terms, placement={"eye": "b"}, steps=steps
    )
    report = TransitionReport(steps=steps, committed=False, reason=WHY)
    answer = Rebalanced(proposal, report)
    monkeypatch.setattr(
        "poise.manage.control_socket.control_client.send_command", lambda *_: answer
    )
    with pytest.raises(typer.Exit):
        balance_command()
    assert f"rolled back: {WHY}" in capsys.readouterr().out


@pytest.mark.parametrize("cost", [-1.0, 1e40, math.inf, math.nan])
def test_refuses_a_cost_that_is_no_cost(cost: float) -> None:
    with pytest.raises(UsageError, match=r"--cost .*: must be a number from 0 to 1e"):
        balance_command(cost=cost)


def test_says_how_much_of_f_is_for_the_moves(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """That of `poise move --dry-run` is without them."""
    now = Terms(total=0.05, communication=0.0, balance=0.05)
    then = Terms(total=0.02143, communication=0.0, balance=0.01143, move=0.01)
    proposal = Proposal(
        shifted={},
        now=now,
        then=then,
        placement={"eye": "b"},
        steps=(TransitionStep("eye", "a", "b"),),
    )
    monkeypatch.setattr(
        "poise.manage.control_socket.control_client.send_command",
        lambda *_: Rebalanced(proposal),
    )
    balance_command(dry=True)
    said = capsys.readouterr().out
    assert "F = 0.05 becomes 0.02143, 0.01 of it for the moves, by:" in said


def test_an_outcome_that_was_rolled_back_is_json_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    report = MigrationReport(
        what="eye",
        before={"eye": "a"},
        after={"eye": "b"},
        committed=False,
        reason=WHY,
        downtime=0.0,
    )
    monkeypatch.setattr(
        "poise.manage.control_socket.control_client.send_command", lambda *_: report
    )
    with pytest.raises(typer.Exit):
        move_command("eye", "b", as_json=True)
    assert json.loads(capsys.readouterr().out)["reason"] == WHY
    with pytest.raises(RolledBack, match="eye stays on a: ValueError") as raised:
        Running("any").move("eye", "b")
    assert raised.value.outcome == report
