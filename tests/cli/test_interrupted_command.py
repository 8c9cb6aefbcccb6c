"""Ctrl-C while a command waits for what the robot goes on with."""

from __future__ import annotations

import signal
from unittest.mock import Mock

import pytest

from poise.cli.running_robot_command import GOES_ON, telling_progress


def test_ctrl_c_amid_a_move_says_that_it_goes_on(
    capfd: pytest.CaptureFixture[str],
) -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), telling_progress(Mock(), GOES_ON):
        signal.raise_signal(signal.SIGINT)
    assert capfd.readouterr().err.startswith("not waiting any more; what has begun")
    assert signal.getsignal(signal.SIGINT) is before
