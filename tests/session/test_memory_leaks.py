"""A container that leaks is named before the kernel kills it."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from poise.emulate import probe_host
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = '''
from poise import Component, every


class Leak(Component):
    """Keeps 1 MB more ten times a second, for 22 s."""

    def configure(self) -> None:
        self._kept = []

    @every(0.1)
    def keep(self) -> None:
        if len(self._kept) < 220:
            self._kept.append(bytearray(b"x" * 1_000_000))


class Once(Component):
    """Allocates 150 MB when it begins."""

    def configure(self) -> None:
        self._kept = bytearray(b"x" * 150_000_000)
'''
ROBOT = """
robot: leaks
computers:
  left: {cpu: 0.5, memory: 600 MiB}
architectures:
  work:
    function: work
    components:
      leak: {implementation: "leak_code:Leak", cpu: 2%, memory: 50 MiB, isolated: true}
      once: {implementation: "leak_code:Once", cpu: 2%, memory: 200 MiB, isolated: true}
tasks:
  work: {actions: [{name: work, functions: [work]}]}
"""


def test_a_leak_is_told_of_before_the_limit_and_until_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 600 MiB about 200 are taken at first; 10 MB come each second."""
    if "memory" not in probe_host().groups.controls:
        pytest.skip("no cgroup to write to with memory")
    (tmp_path / "leak_code.py").write_text(CODE)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    monkeypatch.chdir(tmp_path)
    robot = poise.load("robot.yaml")
    said: list[str] = []
    with poise.up(robot, task="work", say=said.append) as running:

        def leaks() -> list[str]:
            found = [each.what for each in running.status().deviations]
            return [what for what in found if "more each second" in what]

        wait_long(leaks)
        (what,) = leaks()
        assert what.startswith("container 'work.leak' on 'left' (leak) takes ")
        assert "50 MiB were expected" in what
        assert "the limit of 600 MiB is reached in" in what
        wait_long(lambda: not leaks())
        assert all(each.faults == () for each in running.status().computers.values())
    told = "\n".join(said)
    assert what in told
    assert f"no more: {what}" in told
    assert "container 'work.once'" not in told
