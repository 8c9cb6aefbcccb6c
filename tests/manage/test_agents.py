"""What comes from agents, or from whoever says that it is one."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from poise.manage.agent_messages import reading
from poise.wire.records.deployment import AgentStatus


class Payload:
    """What zenoh hands over."""

    key_expr = "poise/robot/status/left"

    def __init__(self, body: bytes) -> None:
        self.payload = self
        self._body = body

    def to_bytes(self) -> bytes:
        return self._body


def test_what_is_no_record_is_logged_and_the_next_one_taken(
    caplog: pytest.LogCaptureFixture,
) -> None:
    heard: list[AgentStatus] = []
    hear: Any = reading(AgentStatus, heard.append)
    hear(Payload(b"\xc1 nonsense"))
    assert "poise/robot/status/left: refused: " in caplog.text
    status = AgentStatus(computer="left", generation=1, uptime=0.0, cpu=0.0)
    hear(Payload(msgspec.msgpack.encode(status)))
    assert heard == [status]
