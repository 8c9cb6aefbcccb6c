"""What docs/ros2.md shows works as it is written there."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.command import run_poise
from tests.waiting import LONG

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

PAGE = Path(__file__).parents[2] / "docs/ros2.md"


def test_the_example_runs(tmp_path: Path) -> None:
    text = PAGE.read_text()
    blocks = re.findall(r"`([\w.]+)`[^`\n]*:\n\n```\w+\n(.*?)```", text, re.DOTALL)
    blocks += re.findall(r"`(nodes\.py)` .*?\n\n```\w+\n(.*?)```", text, re.DOTALL)
    for name, code in blocks:
        (tmp_path / name).write_text(code)
    assert sorted(p.name for p in tmp_path.glob("*.*")) == [
        *("nodes.py", "parts.py", "robot.yaml"),
    ]
    (command,) = re.findall(r"\$ poise (run .*)", text)
    done = run_poise(*command.split(), cwd=tmp_path)
    shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "ear has 20" in said
    assert "printer has 20" in said
    assert "Traceback" not in said
