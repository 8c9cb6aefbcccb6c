"""What a container said before it ended is known, however soon its end is."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from poise.clock import SystemClock
from poise.runtime.agent.supervision.container_processes import ProcessEnd
from poise.runtime.agent.supervision.supervisor import Supervisor
from poise.runtime.hosting.stats_page import new_memory
from poise.wire import record_channel
from poise.wire.records.container import ContainerFailure
from poise.wire.records.status import ContainerStatus

pytestmark = pytest.mark.slow


def test_an_end_that_is_known_before_its_reason_was_read_has_it(tmp_path: Path) -> None:
    zygote, agents_end = socket.socketpair()
    ours, theirs = socket.socketpair()
    supervisor = Supervisor(zygote, "left", tmp_path, SystemClock())
    assert supervisor.adopt("see", os.getpid(), ours, new_memory())
    with zygote, agents_end, theirs:
        record_channel.send(theirs, ContainerFailure("its command ended"))
        record_channel.send(theirs, ContainerStatus(name="see", pid=7, cpu=1.5))
        theirs.close()
        supervisor.note_ended(os.getpid(), ProcessEnd(1 << 8))
    (health,) = supervisor.records({})
    assert health.last_fault
    assert health.last_fault.message == "ended with exit code 1; its command ended"
    assert supervisor.cpu_of_ended == 1.5
