"""A robot that is broken at random comes back each time.

`make soak` does it for longer.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.chaos.__main__ import summary
from tests.chaos.chaos import Chaos

pytestmark = pytest.mark.slow


@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    "seconds", [15.0, pytest.param(60.0, marks=pytest.mark.exhaustive)]
)
def test_comes_back_each_time(tmp_path: Path, seconds: float) -> None:
    said: list[str] = []
    chaos = Chaos(tmp_path, random.Random(7), said.append)
    with chaos.begun():
        chaos.go(seconds)
    report = chaos.finish()
    assert not report.trouble, "\n".join([*said, summary(report)])
    assert report.settled
    assert report.received
    assert report.answered
