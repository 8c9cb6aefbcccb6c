"""What `poise balance` prints."""

from __future__ import annotations

import pytest
import typer

from poise.cli.balance import balance_command
from poise.manage.adaptation.replan import Proposal
from poise.manage.control_socket.records import Rebalanced
from poise.manage.migration.transition import Step
from poise.manage.migration.transition_run import TransitionReport
from poise.plan import Terms

WHY = "ValueError at\n    maps[name] = found[/tmp] + [i for i in rest]"


def test_why_it_was_called_off_is_told_as_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = (Step(kind="move", component="eye", source="a", target="b"),)
    terms = Terms(total=0.5, communication=0.0, balance=0.5)
    proposal = Proposal(
        shifted={}, now=terms, then=terms, placement={"eye": "b"}, steps=steps
    )
    report = TransitionReport(steps=steps, committed=False, reason=WHY)
    answer = Rebalanced(proposal, report)
    monkeypatch.setattr("poise.cli.balance.send_command", lambda *_: answer)
    with pytest.raises(typer.Exit):
        balance_command()
    assert f"rolled back: {WHY}" in capsys.readouterr().out
