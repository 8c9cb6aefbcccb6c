"""Which connectors `poise record --all` records."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import poise.view.robot_recording as module
from poise.clock import steady_wall_time, wall_time
from poise.session.running_robots.running import Status
from poise.view.robot_recording import Recorder
from poise.view.robot_view import LiveReading
from poise.wire.codec import pack
from poise.wire.recording_file import McapFile
from poise.wire.records.request_records import ManagerId, Passed, TapReading
from poise.wire.records.status_records import (
    AgentStatus,
    ConnectorStatus,
    ContainerStatus,
)
from tests.waiting import LONG

reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")


class Live:
    """A robot whose second action begins another connector."""

    def __init__(self, robot: str) -> None:
        self.running = self
        self.robot = robot
        self.polls = 0

    def poll(self) -> LiveReading:
        self.polls += 1
        names = ("eye.seen-mind.seen", "mind.goal-leg.goal")[: self.polls]
        ends = tuple(
            ConnectorStatus(name=n, kind="direct", end="both", ready=True)
            for n in names
        )
        container = ContainerStatus(name="c", pid=1, connectors=ends)
        left = AgentStatus(
            computer="left", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
        )
        status = Status(
            robot=self.robot,
            task="",
            manager=ManagerId(key="k", user="u", host="h", pid=1, since=0.0),
            placement={},
            computers={"left": left},
            by_ros2=("talker-listener /count",),
        )
        return LiveReading(status=status)

    def look_at(self, connector: str, *_: Any, **__: Any) -> TapReading:
        at = steady_wall_time()() + AHEAD.get(connector, 0.0)
        passed = Passed(at=at, value=pack(7), is_whole=True)
        return TapReading(
            number=1,
            connector=connector,
            carries="int",
            times=(at,),
            passed=(passed,),
            at=at,
        )


AHEAD = {"eye.seen-mind.seen": 3e7, "mind.goal-leg.goal": -3e7}
"""Connector -> how far the clock where it begins is ahead [s]."""


def test_all_are_recorded_also_those_that_begin_later_but_for_those_of_ros2(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clock = SimpleNamespace(monotonic=iter(range(9)).__next__, sleep=lambda _: None)
    monkeypatch.setattr(module, "LiveReader", Live)
    monkeypatch.setattr(module, "time", clock)
    said: list[str] = []
    recorder = Recorder("r", (), 400.0, said.append, every=True)
    with McapFile(tmp_path / "a.mcap", "r") as file:
        recorder.record(file, 6.0, lambda: None, lambda *_: None)
    assert file.counts["/messages/eye/seen-mind/seen"] == 3 + 1  # at the end
    assert file.counts["/messages/mind/goal-leg/goal"] == 2 + 1
    with (tmp_path / "a.mcap").open("rb") as written:
        moments = [
            m.log_time / 1e9 for *_, m in reader.make_reader(written).iter_messages()
        ]
    assert max(abs(moment - wall_time()) for moment in moments) < LONG  # by one clock
    (sentence,) = said
    assert "'talker-listener /count' is not recorded: it is made by ROS 2" in sentence
