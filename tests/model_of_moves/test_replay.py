"""A migration that the model does not know is found; real ones: `test_move.py`."""

from __future__ import annotations

import pytest

from poise.manage.migration.migration_report import MigrationReport
from poise.wire.records.migration_records import Phase, StepTaken
from tests.model_of_moves.replay import replay

pytestmark = pytest.mark.slow

STEPS: list[tuple[str, str, Phase]] = [
    ("one/0", "offer state", "prepare"),
    ("one/1", "pre-copy", "prepare"),
    ("one/1", "request state", "prepare"),
    ("one/0", "await idle", "prepare"),
    ("senders", "buffer", "quiesce"),
    ("one/0", "pause", "quiesce"),
    ("one/0", "drain channels", "quiesce"),
    ("sink/0", "drain channels", "quiesce"),
    ("one/0", "send state", "transfer"),
    ("one/1", "restore state", "transfer"),
    ("one/1", "activate", "transfer"),
    ("one/1", "resume", "resume"),
    ("senders", "release to targets", "resume"),
    ("one/0", "redirect", "commit"),
]


def report(
    steps: list[tuple[str, str, Phase]], *, committed: bool = True
) -> MigrationReport:
    taken = tuple(
        StepTaken(who, step, phase, float(k), k + 0.5)  # type: ignore[arg-type] # some are unknown
        for k, (who, step, phase) in enumerate(steps)
    )
    return MigrationReport(
        what="one",
        before={"one": "a"},
        after={"one": "b"},
        committed=committed,
        steps=taken,
    )


def test_the_model_knows_a_move() -> None:
    assert replay(report(STEPS), "one") == ""


def test_the_model_knows_a_move_that_rolls_back() -> None:
    back: list[tuple[str, str, Phase]] = [
        *STEPS[:7],
        ("one/0", "roll back", "roll back"),
        ("senders", "release to sources", "roll back"),
    ]
    assert replay(report(back, committed=False), "one") == ""


def test_a_step_that_the_model_does_not_know_is_found() -> None:
    steps = [*STEPS[:4], ("one/0", "freeze", "quiesce"), *STEPS[4:]]
    assert replay(report(steps), "one") == (
        "the model does not know the step 'freeze at old 0'"
    )


@pytest.mark.parametrize(
    ("moved", "to"),
    [
        ("pause", 1),  # before the target is ready
        ("resume", 9),  # before the state is restored
        ("drain channels", 4),  # before anything is paused
        ("restore state", 7),  # before the source is drained
        ("redirect", 8),  # before the commit
    ],
)
def test_steps_in_an_order_that_the_model_does_not_allow_are_found(
    moved: str, to: int
) -> None:
    steps = list(STEPS)
    steps.insert(to, steps.pop(next(k for k, s in enumerate(STEPS) if s[1] == moved)))
    assert replay(report(steps), "one").startswith("the model does not allow")


def test_a_step_that_is_left_out_is_found() -> None:
    assert replay(report([s for s in STEPS if s[1] != "pause"]), "one") != ""
