"""How long a zygote keeps containers whose agent is gone."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

CODE = """
import itertools, signal, socket, subprocess, sys
from poise.runtime.container import zygote

zygote.ORPHAN_LIMIT, zygote.PATIENCE, zygote._LOOK_EVERY = 0.2, 0.0, 0.05
agents = itertools.chain({looks}, itertools.repeat(False))
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
    ("looks", "lasts", "outcome"),
    [
        ([False, False, True] * 10, 1, "waited"),
        ([True] + [False] * 20, 60, "gave up"),
    ],
)
def test_containers_stay_while_agents_come_back(
    looks: list[bool], lasts: int, outcome: str
) -> None:
    """One that was killed just when the zygote looks is no end of all agents."""
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(looks=looks, lasts=lasts)],
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.stdout.strip() == outcome, done.stderr
