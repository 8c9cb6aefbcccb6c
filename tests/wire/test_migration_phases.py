"""A phase follows only those that the table allows."""

from __future__ import annotations

import itertools
from typing import get_args

import pytest

from poise.errors import RunError
from poise.wire.records.migration_records import (
    TRANSITIONS,
    MigrationPhases,
    Phase,
    Role,
)


def phases(role: Role, *way: Phase) -> MigrationPhases:
    machine = MigrationPhases(role, "migration of component 'one'")
    for phase in way:
        machine.enter(phase)
    return machine


def test_a_migration_has_these_phases() -> None:
    way: tuple[Phase, ...] = ("prepare", "quiesce", "transfer", "commit", "resume")
    assert list(phases("manager", *way).seconds()) == list(way)


def test_an_illegal_phase_names_both() -> None:
    machine = phases("manager", "prepare", "quiesce", "transfer", "commit")
    with pytest.raises(RunError) as caught:
        machine.enter("roll back")
    assert str(caught.value) == (
        "migration of component 'one': phase 'roll back', which may not follow "
        "'commit' (only resume)"
    )


@pytest.mark.parametrize("role", get_args(Role))
def test_nothing_rolls_back_after_the_commit(role: Role) -> None:
    """Else source and target could work at once."""
    following = TRANSITIONS[role]
    reached, waiting = set[str](), ["commit", "resume"]
    while waiting:
        phase = waiting.pop()
        reached.add(phase)
        waiting += following.get(phase, frozenset()) - reached  # type: ignore[call-overload]
    assert "roll back" not in reached


def test_a_step_that_fails_leaves_the_phase() -> None:
    machine = phases("source", "prepare")
    with pytest.raises(LookupError), machine.taking("pause", "quiesce"):
        raise LookupError
    with pytest.raises(RunError, match="step 'send state' leads to phase 'transfer'"):
        machine.taking("send state", "transfer").__enter__()


def test_a_step_that_is_overtaken_by_a_roll_back_fails() -> None:
    machine = phases("source", "prepare")
    with (
        pytest.raises(RunError, match="'quiesce', which may not follow 'roll back'"),
        machine.taking("pause", "quiesce"),
    ):
        machine.enter("roll back")


def test_a_phase_may_have_begun_before(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(10.0)
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    machine = phases("manager", "prepare", "quiesce")  # made at 10, 11, 12
    machine.enter("transfer", since=12.5)
    assert machine.seconds() == {"prepare": 1.0, "quiesce": 0.5, "transfer": 0.5}
