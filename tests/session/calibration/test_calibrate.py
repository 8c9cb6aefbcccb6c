"""What is measured on a busy computer is not believed."""

from poise.session.calibration.calibrate import _waiting
from poise.wire.records.deployment import Summary


def test_a_real_computer_is_busy_when_a_component_waits() -> None:
    assert _waiting("arm", {"waited": Summary(mean=0.05)}) == ""
    assert _waiting("arm", {"waited": Summary(mean=0.4)}) == (
        "computer 'arm' was too busy: a component that wanted to run waited for 40% of "
        "the time"
    )


def test_a_computer_without_a_score_was_too_busy() -> None:
    assert _waiting("arm", {}) == "computer 'arm' was too busy to be measured"
