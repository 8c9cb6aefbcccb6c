"""A robot that is broken at random for a minute comes back each time.

`make soak` does it for longer.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.chaos.__main__ import summary
from tests.chaos.chaos import Chaos

pytestmark = pytest.mark.slow
TIME = 60.0


@pytest.mark.timeout(400)
def test_comes_back_each_time(tmp_path: Path) -> None:
    said: list[str] = []
    chaos = Chaos(tmp_path, random.Random(7), said.append)
    with chaos.begun():
        chaos.go(TIME)
    report = chaos.finish()
    assert not report.trouble, "\n".join([*said, summary(report)])
    assert report.settled
    assert report.received
    assert report.answered
