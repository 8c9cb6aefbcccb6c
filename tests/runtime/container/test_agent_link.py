"""What a container hears of its agent, which may stand still amid a record."""

from __future__ import annotations

import errno
import math
import os
import socket
from pathlib import Path
from unittest.mock import Mock

import pytest

from poise.clock import SystemClock
from poise.runtime.container.agent_link import AgentLink
from poise.wire import frame
from poise.wire.records.heartbeat_records import Clocks

pytestmark = pytest.mark.slow

SAID = Clocks({}, frozenset({"vision"}))


def test_a_record_may_come_in_pieces_and_nobody_waits_for_the_rest(
    tmp_path: Path,
) -> None:
    agent, its = socket.socketpair()
    with agent, its:
        link = AgentLink("see", its, -1, tmp_path, SystemClock())
        frame.send_record(agent, SAID)
        *pieces, last = [bytes([each]) for each in its.recv(1 << 16)]
        for piece in pieces:
            agent.send(piece)
            assert link.receive() is None
        assert link.files()
        agent.send(last)
        assert link.receive() == SAID


def test_an_agent_that_is_killed_amid_a_record_is_gone(tmp_path: Path) -> None:
    agent, its = socket.socketpair()
    with agent, its:
        link = AgentLink("see", its, -1, tmp_path, SystemClock())
        agent.send(b"half")
        agent.close()
        assert link.receive() is None
        assert not link.files()


def test_it_asks_for_adoption_again_when_a_descriptor_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, its = socket.socketpair()
    with agent, its:
        link = AgentLink("see", its, -1, tmp_path, SystemClock())
        agent.close()
        assert link.receive() is None
        error = OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        monkeypatch.setattr(socket, "socket", Mock(side_effect=error))
        link.ask_when_due()
    assert not link.files()
    assert link.due < math.inf
