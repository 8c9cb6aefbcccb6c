"""What was measured is believed when it agrees with itself, whatever else ran."""

import pytest

from poise.session.profiling.calibrate import _doubt


@pytest.mark.parametrize(
    ("slowest", "doubt"),
    [
        (96.0, ""),
        (
            80.0,
            (
                "the speed of computer 'arm' was not steady: the quickest runs of 4 "
                "series differ by 25%"
            ),
        ),
    ],
)
def test_a_speed_is_believed_when_its_quickest_runs_agree(
    slowest: float, doubt: str
) -> None:
    assert _doubt("arm", (100.0, slowest, 99.0, 98.0)) == doubt


def test_a_computer_without_a_score_was_too_busy() -> None:
    assert _doubt("arm", ()) == "computer 'arm' was too busy to be measured"
