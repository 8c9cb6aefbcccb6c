"""Recorded messages that are played again."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from poise.errors import UsageError
from poise.session.running_robots import playback
from poise.session.running_robots.running import Running
from poise.wire.recording_file import MESSAGES, McapFile, Said
from tests.bags import write_bag


def test_nothing_is_played_when_a_port_is_not_in_the_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    published: list[object] = []
    asked: list[str] = []

    def component(name: str) -> Any:
        asked.append(name)
        return SimpleNamespace(publish=lambda *what, **_: published.append(what))

    said = Said(connector="eye.seen-mind.seen", at=1.0, value=7)
    monkeypatch.setattr(playback, "said_in", lambda *_, **__: iter([said, said]))
    monkeypatch.setattr(
        playback, "connect", lambda _: SimpleNamespace(component=component)
    )
    with pytest.raises(UsageError, match=r"r\.mcap has nothing of eye\.typo"):
        playback.play("r.mcap", only=["eye.seen", "eye.typo"])
    assert not published
    assert playback.play("r.mcap", only=["eye.seen"]).messages == {"eye.seen": 2}
    assert published == [("seen", 7), ("seen", 7)]
    assert asked == ["eye"]  # each time would cost a status of the robot


def test_that_a_recording_was_cut_off_is_said_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "cut.mcap"
    with McapFile(path, "r", at_once=True) as file:
        file.add(f"{MESSAGES}/eye.seen-mind.seen", None, 1.0, 7)
        cut = path.read_bytes()
    path.write_bytes(cut)
    eye = SimpleNamespace(publish=lambda *_, **__: None)
    robot = SimpleNamespace(component=lambda _: eye)
    monkeypatch.setattr(playback, "connect", lambda _: robot)
    assert playback.play(path, only=["eye.seen"]).messages == {"eye.seen": 1}
    assert caplog.text.count("was not closed") == 1
    with pytest.raises(UsageError, match="has nothing of eye"):
        playback.play(path, only=["eye.left"])
    assert caplog.text.count("was not closed") == 2


def test_a_recording_without_messages_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Such is what `poise record` writes of a robot when it is given no connector."""
    monkeypatch.setattr(playback, "said_in", lambda *_, **__: iter(()))
    monkeypatch.setattr(playback, "connect", Running)
    with pytest.raises(UsageError, match=r"no message is recorded in r\.mcap: `poise"):
        playback.play("r.mcap")


def test_a_bag_is_left_to_ros2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playback, "connect", lambda _: SimpleNamespace(component=None))
    write_bag(tmp_path / "drive", 1)
    for path in (tmp_path / "drive", tmp_path / "drive" / "drive.mcap"):
        with pytest.raises(UsageError, match=r"drive.* is no file .*`ros2 bag play`"):
            playback.play(path)
