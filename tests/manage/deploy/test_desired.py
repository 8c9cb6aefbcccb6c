"""What a commit changes, in words for the journal."""

from __future__ import annotations

from poise.manage.deploy.desired import Desired, Incarnation, difference


def test_a_long_parameter_does_not_fill_the_journal() -> None:
    """A line of it took as much of the journal as all that had happened before."""
    before = Desired(placed={})
    after = before.with_parameters("camera", {"mask": "y" * 10_000, "gain": 0.5})
    (changed,) = difference(before, after)
    assert changed.startswith("parameters of camera: mask = 'yyy")
    assert changed.endswith("..., gain = 0.5")
    assert len(changed) < 200


def test_what_has_taken_over_follows_nothing_when_it_starts_again() -> None:
    target = Incarnation(
        component="bridge", computer="left", epoch=1, goal="inactive", follows=True
    )
    moved = Desired().placing([target.with_goal("active")])
    assert not moved.placed["bridge"].follows
    assert target.with_goal("inactive").follows
