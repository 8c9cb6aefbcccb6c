"""Who stands still for longer than a computer may be silent loses nothing."""

from __future__ import annotations

import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.errors import CallError
from poise.wire.address import LOST_AFTER, Address
from poise.wire.connections.channel import Channel
from tests.waiting import LIMIT

from .conftest import message

SERVE = """
import pathlib, sys, threading
from poise.wire.codec import codec
from poise.wire.connections.gateway import Gateway
from poise.wire.connections.connection_server import ConnectionServer

folder = pathlib.Path(sys.argv[1])
server = ConnectionServer(folder, "there")
server.open("many", lambda received: print(len(received.body), flush=True))
with Gateway(folder, "127.0.0.1") as gateway:
    print(gateway, flush=True)
    threading.Event().wait()
"""
SMALLEST = 300_000
"""What TCP holds for who takes nothing is a few megabytes [bytes]."""

pytestmark = pytest.mark.slow


@pytest.fixture
def there(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Give a process that says how long each message is."""
    argv = [sys.executable, "-c", SERVE, str(tmp_path)]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, bufsize=0)
    yield process
    process.kill()
    process.communicate(timeout=LIMIT)


def line(process: subprocess.Popen[bytes]) -> str:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], LIMIT)
    assert ready, "nothing came"
    return process.stdout.readline().decode().strip()


def test_what_was_sent_to_a_process_that_stood_still_arrives(
    there: subprocess.Popen[bytes], tmp_path: Path
) -> None:
    address = Address.parse(f"{line(there)}/there")
    channel = Channel("many", address, tmp_path)
    channel.push(message("x" * SMALLEST), LIMIT)
    head = int(line(there)) - SMALLEST
    there.send_signal(signal.SIGSTOP)
    sent: list[int] = []
    end = time.monotonic() + 2 * LOST_AFTER
    while time.monotonic() < end:
        length = SMALLEST + 1 + len(sent)
        try:
            channel.push(message("x" * length), end - time.monotonic())
        except CallError:
            continue
        sent.append(length)
    assert len(sent) > 1
    there.send_signal(signal.SIGCONT)
    arrived = [int(line(there)) - head for _ in sent]
    assert arrived == sent
    channel.close()
