"""The simulated cell as a process, as `poise run` starts it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sorter.device import NAMES, Device
from tests.sorter.loop import EXAMPLE

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, "-m", "sorter.world", "--endless", "--seed", "3"]
LIMIT = 60.0


def test_serves_its_devices_and_says_how_it_went(tmp_path: Path) -> None:
    process = subprocess.Popen(
        COMMAND,
        cwd=EXAMPLE,
        env={**os.environ, "POISE_RUN": str(tmp_path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        assert {path.stem for path in tmp_path.iterdir()} == set(NAMES)
        arm = Device(str(tmp_path / "arm.sock"))
        while arm.newest() is None:
            assert process.poll() is None
        arm.send([0.5, 0.9, -1.6, -0.87])
        arm.close()
        out, _ = process.communicate(timeout=LIMIT)
    assert process.returncode == 0
    result = json.loads(out)
    assert result["functions"].keys() == {each["name"] for each in result["criteria"]}
    assert list(tmp_path.iterdir()) == []


def test_says_what_it_needs() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "POISE_RUN"}
    ended = subprocess.run(
        COMMAND,
        cwd=EXAMPLE,
        env=environment,
        capture_output=True,
        timeout=LIMIT,
        check=False,
    )
    assert ended.returncode == 2
    assert b"POISE_RUN" in ended.stderr
