"""The example of the page on the repository runs as it stands there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import run_poise
from tests.waiting import LONG

PAGE = (Path(__file__).parents[2] / "docs" / "repository.md").read_text()


@pytest.mark.slow
def test_the_example_runs(tmp_path: Path) -> None:
    """An outcome changes the choice; `show` has it, and `reset` forgets it."""
    robot, parts = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    classes, learning = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "parts").mkdir()
    (tmp_path / "robot.yaml").write_text(robot)
    (tmp_path / "parts" / "grasping.yaml").write_text(parts)
    (tmp_path / "parts" / "grasping.py").write_text(classes)
    done = subprocess.run(
        [sys.executable, "-c", learning],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "{'grasping': 'suction'}\n"
    ran = run_poise("run", "robot.yaml", "--for", "0.5s", "--report", "x", cwd=tmp_path)
    # a busy machine spoils the figures of the run, of which nothing is asked
    assert ran.returncode == 0 or "they were promised" in ran.stdout, ran.stderr
    journal = run_poise("journal", "x/journal.jsonl", cwd=tmp_path).stdout
    assert re.search(
        r"grasping by 'suction' \([0-9a-f]{12}, /.*grasping.yaml\)", journal
    )
    show, reset = (
        ("repository", name, "gripper", "robot.yaml") for name in ("show", "reset")
    )
    shown = run_poise(*show, cwd=tmp_path).stdout
    assert re.search(r"pick +all computers +33% ± 24%", shown), shown
    assert run_poise(*reset, cwd=tmp_path).returncode == 0
    after = run_poise(*show, cwd=tmp_path).stdout
    assert after.endswith("nothing has been learned yet\n")
