"""`poise record` of a robot that runs, read back with the library of the format."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import subprocess
from collections import Counter
from pathlib import Path
from subprocess import PIPE

import pytest

import poise
from poise.errors import RunError
from poise.wire.robots_here import path_of
from tests.command import POISE, check_output, robot_up, run_poise
from tests.view.test_robot_recording import read
from tests.waiting import LONG, wait_long

pytest.importorskip("mcap", reason="mcap is not installed")
pytestmark = pytest.mark.slow

HELLO = Path(__file__).parents[2] / "examples" / "hello"
NAME = f"recorded{os.getpid()}"
MESSAGES = "/messages/counter/count-printer/count"


def test_records_what_runs_until_it_ends(tmp_path: Path) -> None:
    shutil.copy(HELLO / "hello.py", tmp_path)
    text = (HELLO / "robot.yaml").read_text().replace("robot: hello", f"robot: {NAME}")
    (tmp_path / "robot.yaml").write_text(text)
    path = tmp_path / "a.mcap"
    with robot_up(tmp_path / "robot.yaml", "--placement", "round-robin") as manager:
        argv = ["record", "counter.count", "-o", str(path), "--robot", NAME, "--json"]
        with subprocess.Popen(
            [*POISE, *argv], stdout=PIPE, stderr=PIPE, text=True
        ) as recording:
            assert recording.stderr is not None
            assert "recording robot" in recording.stderr.readline()
            moved = run_poise("move", "counter", "right", "--robot", NAME)
            assert moved.returncode == 0, moved.stderr
            # so that the decision and what came after it are in
            echoed = run_poise("echo", "counter.count", "--robot", NAME, "--count", 20)
            assert echoed.returncode == 0, echoed.stderr
            recording.send_signal(signal.SIGINT)
            said, _ = recording.communicate(timeout=LONG)
        assert recording.returncode == 130
        check_output(argv, said)
        found = read(path)
        assert json.loads(said)["messages"] == Counter(topic for topic, *_ in found)
        topics = {topic for topic, *_ in found}
        assert topics >= {
            "/computers/left",
            "/components/counter",
            "/connectors/counter/count-printer/count",
            "/timers/counter/tick",
            "/decisions",
            MESSAGES,
        }
        numbers = [value["value"] for topic, *_, value in found if topic == MESSAGES]
        # counter has no snapshot: it begins anew where it moved to, once
        steps = [after - before for before, after in itertools.pairwise(numbers)]
        assert len(numbers) > 10
        assert sum(step != 1 for step in steps) <= 1
        decisions = [value for topic, *_, value in found if topic == "/decisions"]
        assert any("counter" in each["message"] for each in decisions)

        with pytest.MonkeyPatch.context() as patched:  # what comes behind the last look
            patched.setattr("poise.view.robot_recording._LOOK_EVERY", LONG)
            short = tmp_path / "short.mcap"
            poise.record(short, ["counter.count"], seconds=1.0, robot=NAME)
        assert sum(topic == MESSAGES for topic, *_ in read(short)) > 3

        other = tmp_path / "b.mcap"
        sentences: list[str] = []

        def kill(now: float, _: str) -> None:
            if now > 0.5 and manager.poll() is None:
                manager.kill()
                wait_long(lambda: manager.poll() is not None)
                path_of(NAME).unlink()  # the next manager would

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("poise.view.robot_recording._PATIENCE", 0.5)
            names = ["counter.count"]
            with pytest.raises(RunError, match=f"robot '{NAME}' has ended"):
                poise.record(other, names, robot=NAME, say=sentences.append, tell=kill)
        assert any("no answer" in each for each in sentences)
        assert f" topics in {other}" in sentences[-1]
        assert read(other)
