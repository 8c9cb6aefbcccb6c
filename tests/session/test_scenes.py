"""The scenes of the demo show what they say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from poise.emulate import look
from tests.command import run_poise

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_components_of_a_crashed_computer_go_on_elsewhere() -> None:
    if reasons := look().without_network():
        pytest.skip("; ".join(reasons))
    done = run_poise(
        "demo", "--scene", "lost-computer", "--json", "--examples", EXAMPLES
    )
    assert done.returncode == 0, done.stderr
    scene = json.loads(done.stdout)
    assert scene["scene"] == "lost-computer"
    assert scene["ok"]
    assert 0 < scene["detected_s"] <= scene["active_s"]
    assert "'left' loses power" in done.stderr
