"""What waits in native code harms nobody when the interpreter begins or ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

ENDS = """
import threading, time
import poise.runtime.execution.exclusion
from poise.errors import Timeout
{}

def work():
    while True:
        try:
            wait()
        except Timeout:
            pass

class Slow:
    def __del__(self):
        time.sleep(0.3)

slow = Slow()
threading.Thread(target=work, daemon=True).start()
time.sleep(0.1)
"""
RECEIVES = """
import socket
from poise.wire.connections.connection import Connection
ours, theirs = socket.socketpair()
connection = Connection(ours)

def wait():
    connection.receive(time.monotonic() + 0.01)
"""
ENTERS = """
from poise.runtime._calls import Exclusion
exclusion = Exclusion("busy")

def wait():
    exclusion.enter(1, 0.01)
"""
SOLVES = """
from poise.model.robot import Computer
from poise.plan import Item, Problem
from poise.plan._core import Core
from poise.plan.problem.arrays import arrays_of
items = tuple(Item(name=str(i), demand={"cpu": 0.1 + i}) for i in range(30))
computers = tuple(Computer(name=name, capacity={"cpu": 999.0}) for name in "ab")
core = Core(arrays_of(Problem(components=items, computers=computers)))

def wait():
    core.search([], 0.01, 10**9, 0)
"""
CLOSES = """
import socket, sys, time
from poise.cli import main
from poise.wire.control_session import close_session, open_session

hung = socket.create_server(("127.0.0.1", 0))  # as a computer that stands still

def work(_words):
    session = open_session(connect=[f"tcp/127.0.0.1:{hung.getsockname()[1]}"])
    time.sleep(0.5)
    close_session(session)
    sys.exit(3)

"""
AS_SCRIPT = f"{CLOSES}work([])"
AS_COMMAND = f"{CLOSES}main._run = work\nmain.run_process()"
FIRST_FRAMES = """
import threading, time
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.frame import FrameKind

class Slow:
    def __iter__(self):
        time.sleep(0.2)
        return iter(FrameKind)

frame.FrameKind = Slow()
text = codec(str)
threads = [
    threading.Thread(target=frame.segments, args=(text, "first", FrameKind.HELLO))
    for _ in range(4)
]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


def run(code: str) -> subprocess.CompletedProcess[str]:
    argv = [sys.executable, "-c", code]
    return subprocess.run(
        argv, capture_output=True, text=True, timeout=LIMIT, check=False
    )


@pytest.mark.parametrize(
    "waits", [RECEIVES, ENTERS, SOLVES], ids=["receives", "enters", "solves"]
)
def test_a_thread_that_waits_while_the_interpreter_ends_does_not_abort_it(
    waits: str,
) -> None:
    ended = run(ENDS.format(waits))
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(
    "closes",
    [AS_COMMAND, pytest.param(AS_SCRIPT, marks=pytest.mark.exhaustive)],
    ids=["command", "script"],
)
def test_a_session_that_takes_long_to_close_does_not_abort_it(closes: str) -> None:
    """As when a computer is lost: a script waits for up to 10 s, a command does not."""
    ended = run(closes)
    assert (ended.returncode, ended.stderr) == (3, "")


def test_threads_may_send_their_first_frames_at_the_same_time() -> None:
    ended = run(FIRST_FRAMES)
    assert (ended.returncode, ended.stderr) == (0, "")
