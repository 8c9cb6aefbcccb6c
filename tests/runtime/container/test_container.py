"""A container does not depend on an agent that is slow to listen."""

import contextlib
import socket
from pathlib import Path

import pytest

from poise.runtime.container.container import Container
from poise.runtime.hosting.stats_page import new_memory
from poise.runtime.hosting.wiring import Place
from poise.wire.records.deployment import ContainerSpec

pytestmark = pytest.mark.slow


def test_no_status_waits_for_an_agent_that_stands_still(tmp_path: Path) -> None:
    agent, ours = socket.socketpair()
    place = Place(container="see", folder=str(tmp_path), gateway="", computer="a")
    with agent, ours:
        container = Container("see", ours, new_memory(), place)
        container._wanted = ContainerSpec(
            name="see", folder="", components=(), connectors=()
        )
        ours.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                ours.send(bytes(1 << 16))
        ours.setblocking(True)
        container._report(container._status())  # raises Timeout if it waits
