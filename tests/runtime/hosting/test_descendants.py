"""Which children a container reaps, and which it leaves to its components."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

CODE = """
import os, subprocess, threading
from poise.runtime.hosting.descendants import Orphans, adopt_orphans, children

now, steps, lasting = 0.0, threading.Semaphore(0), threading.Semaphore(0)
adopt_orphans()
orphans = Orphans(lambda: now)
own = []

def start(thread):
    own.append(subprocess.Popen(["sh", "-c", f"exit {thread}"]))
    # its parent ends, and it stays in this session
    subprocess.run(["sh", "-c", "sleep 0 &"])
    steps.release()
    lasting.acquire()

threads = [threading.Thread(target=start, args=(n,), daemon=True) for n in (3, 4)]
for thread in threads:
    thread.start()
for thread in threads:
    steps.acquire()
adopted = children() - {each.pid for each in own}
assert len(adopted) == 2, adopted
for child in children():  # it has ended
    os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
orphans.reap()
assert adopted < children()
lasting.release()  # the child of one thread comes to the main thread
while sum(map(threading.Thread.is_alive, threads)) == 2:
    pass
now = 9.0
orphans.reap()
assert adopted < children()
now = 11.0
orphans.reap()
assert children() == {each.pid for each in own}, (adopted, children())
now = 50.0
orphans.reap()
assert sorted(each.wait() for each in own) == [3, 4]
"""


def test_an_orphan_in_the_same_session_is_reaped_and_no_exit_code_is_lost() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
