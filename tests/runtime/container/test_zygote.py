"""How a zygote starts, and how long it keeps containers whose agent is gone."""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import pytest

from poise.errors import RunError
from poise.runtime.container import zygote
from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

CODE = """
import itertools, signal, socket, subprocess, sys
from poise.runtime.container import zygote

zygote.ORPHAN_LIMIT, zygote.PATIENCE, zygote._LOOK_EVERY = {limit}, 0.0, 0.05
agents = {looks}
zygote.is_adopting = lambda _: next(agents)
own, agent = socket.socketpair()
keeper = zygote._Zygote(agent)
signal.set_wakeup_fd(keeper._waker.signal_fd)
signal.signal(signal.SIGCHLD, lambda *_: None)
container = subprocess.Popen(["sleep", "{lasts}"])
keeper._containers.add(container.pid)
keeper._outlive_agent()
outcome = "gave up" if keeper._containers else "waited"
container.kill()
print(outcome)
"""


@pytest.mark.parametrize(
    ("looks", "limit", "lasts", "outcome"),
    [
        ("itertools.cycle([False, False, True])", 1.5, 4, "waited"),
        ("itertools.chain([True], itertools.repeat(False))", 0.2, 60, "gave up"),
    ],
)
def test_containers_stay_while_agents_come_back(
    looks: str, limit: float, lasts: int, outcome: str
) -> None:
    """One that was killed just when the zygote looks is no end of all agents."""
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(looks=looks, limit=limit, lasts=lasts)],
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.stdout.strip() == outcome, done.stderr


def test_a_limit_of_processes_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fork() -> int:
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(os, "fork", fork)
    with pytest.raises(RunError, match=r"no container can be started .*pids\.max"):
        zygote.start()
