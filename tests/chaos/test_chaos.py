"""A robot that is broken at random comes back each time.

`make soak` does it for longer.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.chaos import Chaos


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.timeout(400)
def test_comes_back_each_time_with_nothing_active_twice(tmp_path: Path) -> None:
    said: list[str] = []
    chaos = Chaos(tmp_path, 7, said.append)
    with chaos.begun():
        chaos.go(60.0)
    report = chaos.finish()
    assert not report.trouble, "\n".join([*said, str(report)])
    assert report.settled
    assert report.received
    assert report.answered
