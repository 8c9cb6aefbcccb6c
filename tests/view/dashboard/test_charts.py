"""What the dashboard's charts draw."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from poise.view import dashboard
from tests.waiting import LONG

_NODE = shutil.which("node")
_CHARTS = Path(dashboard.__file__).with_name("charts.js")


@pytest.mark.slow
@pytest.mark.skipif(_NODE is None, reason="no node to run it: apt-get install nodejs")
def test_only_the_last_ten_minutes_are_drawn(tmp_path: Path) -> None:
    """Others are there while no news comes, and after the clock was set."""
    seconds = 9_000, 9_400, 9_401, 10_000, 10_001, 13_600
    moments: dict[int, object] = {second: {} for second in seconds}
    shutil.copy(_CHARTS, tmp_path / "charts.mjs")
    (tmp_path / "run.mjs").write_text(
        'import charts from "./charts.mjs";'
        f"const seen = {{moments: {json.dumps(moments)}, now: 10_000.9}};"
        "const drawn = charts.computed.seconds.call(seen);"
        "console.log(JSON.stringify(drawn.map(([second]) => second)))"
    )
    done = subprocess.run(
        [str(_NODE), "run.mjs"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=True,
    )
    assert json.loads(done.stdout) == [9_401, 10_000]
