"""The programs that keep this machine's CPUs at their full clock."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from poise.emulate import full_speed
from poise.waker import wait_readable
from tests.waiting import wait_long

pytestmark = pytest.mark.slow


def spinners() -> list[int]:
    """Return the children of this process that give way to all others."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return [
        int(pid) for pid in children if os.sched_getscheduler(int(pid)) == os.SCHED_IDLE
    ]


def test_each_cpu_has_one_and_afterwards_none() -> None:
    with full_speed():
        wait_long(lambda: len(spinners()) == len(os.sched_getaffinity(0)))
        cpus = [os.sched_getaffinity(pid) for pid in spinners()]
        assert set.union(*cpus) == os.sched_getaffinity(0)
        assert all(len(each) == 1 for each in cpus)
    assert not spinners()


def test_ctrl_c_in_a_terminal_does_not_reach_them() -> None:
    """Each would write a traceback; the command ends them itself."""
    with full_speed():
        wait_long(lambda: len(spinners()) == len(os.sched_getaffinity(0)))
        assert os.getpgrp() not in map(os.getpgid, spinners())


def test_none_is_left_by_a_process_that_was_killed() -> None:
    code = (
        "import time\nfrom poise.emulate import full_speed\n"
        "with full_speed():\n  print('there', flush=True)\n  time.sleep(100)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout
    process.stdout.readline()
    found = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    ends = [os.pidfd_open(int(pid)) for pid in found.split()]
    process.kill()
    process.wait()
    process.stdout.close()
    assert ends
    for end in ends:
        assert wait_readable([end], 10.0)
        os.close(end)
