"""Draws of a run: by stream, recorded, replayed."""

from __future__ import annotations

from poise.simulation.choices import Choices


def test_one_more_draw_in_a_stream_changes_no_other_stream() -> None:
    one, other = Choices(3), Choices(3)
    one.draw("faults")
    assert one.draw("schedule") == other.draw("schedule")


def test_a_replay_begins_with_what_was_recorded_and_goes_on_by_the_seed() -> None:
    first = Choices(3)
    made = [first.draw("schedule") for _ in range(4)]
    again = Choices(3, {"schedule": [0.0, made[1]]})
    replayed = [again.draw("schedule") for _ in range(4)]
    assert replayed == [0.0, *made[1:]]


def test_draws_of_zero_choose_the_first_and_let_nothing_happen() -> None:
    choices = Choices(3, {"schedule": [0.0] * 2, "faults": [0.0]})
    assert choices.among("schedule", 5) == 0
    assert choices.between("schedule", 2.0, 9.0) == 2.0
    assert not choices.happens("faults", 0.99)
