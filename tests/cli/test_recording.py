"""`poise recording`, on what a run would have left."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from poise.cli import recording_command
from poise.session import Say
from poise.session.running_robots.playback import Playback
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ContainerSample,
)
from tests.command import Poise, called
from tests.recordings import write_recording

ROBOT = """\
robot: r
computers: {a: {cpu: 1, memory: 1 GiB}}
architectures:
  see: {function: seeing, components: {eye: {cpu: 10%}}}
"""


def told(at: float) -> AgentSample:
    """Return what was used: 10 % of a core, and from 20 s on 40 %."""
    used = 0.1 * at + 0.3 * max(0.0, at - 20)
    jobs = round(10 * at)
    eye = ComponentSample("eye", 0, used, 0.0, jobs, jobs)
    return AgentSample(
        "a", at, 0.0, (ContainerSample("see", 1, at, used, 1, (eye,), ()),)
    )


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    samples = [told(0.2 * k) for k in range(300)]
    write_recording(tmp_path / "run.mcap", "r", samples)
    return tmp_path


@pytest.mark.slow
def test_exports_a_table(folder: Path, poise: Poise) -> None:
    done = poise("recording", "export", "run.mcap", "--to", "run.csv")
    assert done.stdout == "300 rows of components in run.csv\n"
    assert len((folder / "run.csv").read_text().splitlines()) == 301
    refused = poise("recording", "export", "run.mcap", "--to", "run.csv", "--json")
    assert (refused.returncode, json.loads(refused.stdout)["kind"]) == (2, "UsageError")


@pytest.mark.slow
def test_replays_into_the_estimator(folder: Path, poise: Poise) -> None:
    """60 s: at the end only what was used in the last 30 s counts, 40 % of a core."""
    assert folder.exists()
    replay = ("recording", "replay", "run.mcap", "--robot", "robot.yaml")
    done = poise(*replay, "--json")
    assert done.returncode == 0, done.stderr
    (standing,) = json.loads(done.stdout)
    assert standing["estimate"]["mean"] == pytest.approx(0.4, abs=0.01)
    assert re.search("2[0-9.]+ s: 'eye' needs .* of a core, 10.0% before", done.stderr)
    assert "40.0%" in poise(*replay).stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("export", "run.mcap"), "give a file: --to"),
        (("replay", "run.mcap"), "give the robot file: --robot"),
        (("export", "robot.yaml", "--to", "x.csv"), "robot.yaml is not a recording"),
        (("export", "none", "--to", "x.csv"), "cannot be read"),
    ],
)
def test_says_how_to_use_it(
    folder: Path, poise: Poise, words: tuple[str, ...], says: str
) -> None:
    assert folder.exists()
    done = poise("recording", *words)
    assert done.returncode == 2
    assert says in done.stderr


@pytest.mark.slow
def test_says_whose_recording_it_is(folder: Path, poise: Poise) -> None:
    (folder / "robot.yaml").write_text(ROBOT.replace("robot: r", "robot: s"))
    done = poise("recording", "replay", "run.mcap", "--robot", "robot.yaml")
    assert "was recorded of robot 'r', not of 's'" in done.stderr


def test_each_sentence_of_play_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """However narrow the terminal is, and though a reason looks like markup."""
    why = f"eye.seen: not played, {'as [bold]nobody[/] listens there, ' * 20}so far"

    def play(*_: object, say: Say, **__: object) -> Playback:
        say(why)
        return Playback(messages={"eye.heard": 3}, skipped={"eye.seen": why}, behind=0)

    monkeypatch.setattr(recording_command, "play", play)
    done = called(["play", "run.mcap"])
    assert done.stdout == f"{why}\neye.heard: 3 messages\n"
    assert done.returncode == 1
