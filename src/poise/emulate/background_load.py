"""A program that takes CPU on an emulated computer, as other software on it would."""

from __future__ import annotations

import sys
import time

_PERIOD = 0.02
"""It takes its share of each of these [s]."""


def background_load(cores: float) -> list[str]:
    """Return the command of a program that takes `cores` [at most 1].

    It imports nothing of Poise, so that it is at work at once.
    """
    return [sys.executable, "-I", __file__, f"{cores:g}"]


def burn(cores: float) -> None:
    """Use `cores` [at most 1] of a host CPU, where that is to be had, for ever."""
    while True:
        end = time.monotonic() + _PERIOD
        used = time.process_time() + cores * _PERIOD
        while time.process_time() < used and time.monotonic() < end:
            pass
        time.sleep(max(0.0, end - time.monotonic()))


if __name__ == "__main__":
    burn(float(sys.argv[1]))
