"""`poise profile` from end to end, on a small robot with all kinds of components."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.estimate import profiles as profile_file
from poise.estimate.profiles import Profile, Store
from tests.command import Poise

ROBOT = """\
robot: joined
computers:
  main: {cpu: 1, memory: 1 GiB}
  side: {cpu: 1, memory: 1 GiB}
architectures:
  seeing:
    function: seeing
    components:
      eye: {implementation: "joined:Eye"}
      memory: {implementation: "joined:Memory"}
      heart: {command: "sleep 1000"}
    connectors: [{between: [eye.found, memory.found]}]
  thinking:
    function: thinking
    components:
      mind: {implementation: "joined:Mind"}
      archive: {implementation: "joined:Archive", isolated: true}
    connectors: [{between: [mind.archive, archive.archive]}]
connectors:
  - {between: [memory.known, mind.known]}
  - {between: [mind.looking, eye.looking]}
tasks: {think: {actions: [{name: think, functions: [seeing, thinking]}]}}
profile: profile.yaml
"""
CODE = """
import time
from poise import Component, Message, Provided, Published, Required, every, subscribed

class Found(Message):
    text: str

class Looking:
    def look(self, where: str) -> str:
        raise NotImplementedError

class Archived:
    def keep(self, text: str) -> int:
        raise NotImplementedError

class Eye(Component):
    found: Published[Found]
    looking: Provided[Looking]

    @every(0.05, deadline=0.05)
    def see(self) -> None:
        self.found.publish(Found("w" * 300))

    def look(self, where: str) -> str:
        return where

class Memory(Component):
    known: Published[Found]

    @subscribed(keep=5)
    def found(self, message: Found) -> None:
        self.known.publish(message)

class Archive(Component):
    archive: Provided[Archived]

    def keep(self, text: str) -> int:
        return len(text)

class Mind(Component):
    archive: Required[Archived]
    looking: Required[Looking]

    def configure(self) -> None:
        self.heard = 0

    @every(0.1)
    def think(self) -> None:
        end = time.thread_time() + 0.005
        while time.thread_time() < end:
            pass
        self.archive.keep(self.looking.look("w" * 1000))

    @subscribed(keep=5)
    def known(self, message: Found) -> None:
        self.heard += 1

    def snapshot(self) -> bytes:
        return bytes(2000)

    def restore(self, state: bytes) -> None:
        self.heard = 0
"""
BETWEEN = "memory.known-mind.known", "mind.looking-eye.looking"


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "joined.py").write_text(CODE)
    return tmp_path


def read(folder: Path) -> Profile:
    return profile_file.read(folder / "profile.yaml")


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_measures_shared_isolated_and_command_line_components(
    folder: Path, poise: Poise
) -> None:
    quick = ("--for", "2s", "--warm-up", "500ms", "--repeat", "1")
    done = poise("profile", "robot.yaml", "--architecture", "thinking", *quick)
    assert done.returncode == 0, done.stdout + done.stderr
    profile = read(folder)
    assert set(profile.components) == {"mind", "archive"}
    mind, archive = profile.components["mind"], profile.components["archive"]
    assert mind.cpu.mean > archive.cpu.mean >= 0
    assert mind.cpu.mean <= mind.cpu.p99 <= mind.cpu.peak
    assert min(mind.memory + mind.base, mind.start, archive.memory + archive.base) > 0
    assert mind.state >= 2000
    timer = mind.timers["think"]
    assert timer.period == 0.1
    assert 0.005 <= timer.median <= timer.p99 * 1.05 <= timer.maximum * 1.1
    kept = profile.connectors["mind.archive-archive.archive"]
    assert kept.calls > 0
    # 1000 characters there and a number back, and the heads of both
    assert 1000 < kept.size < 1200
    assert kept.size == pytest.approx(kept.median, rel=0.06)
    assert 1000 < kept.largest < 1200

    # as if measured on a machine 16 times as quick: what joins is given in its cores
    quicker = replace(profile, loops=16 * profile.loops)
    (folder / "profile.yaml").write_text(profile_file.to_text(quicker))
    both = ("--architecture", "seeing", "--architecture", "thinking")
    done = poise("profile", "robot.yaml", *both, *quick, "--on", "main", "--write")
    assert done.returncode == 0, done.stdout + done.stderr
    profile = read(folder)
    assert profile.loops == pytest.approx(quicker.loops, rel=1e-3)
    thinks = profile.components["mind"].handlers["think"].mean
    # the speed of a shared machine may change by a factor of two
    assert 1 / 48 < thinks / mind.handlers["think"].mean < 1 / 6
    assert set(profile.components) == {"eye", "memory", "heart", "mind", "archive"}
    assert profile.components["eye"].timers["see"].maximum > 0
    assert profile.components["heart"].start > 0
    assert profile.connectors[BETWEEN[1]].calls > 0
    assert set(BETWEEN) <= set(profile.connectors)
    assert "demands written to robot.yaml" in done.stdout
    assert "cpu:" in (folder / "robot.yaml").read_text().split("archive:")[1]
    with Store(folder / ".poise" / "profiles.sqlite") as store:
        # a command that found the machine too busy ran anew, and added one more
        assert len(store.all("joined")) >= 2

    (folder / "joined.py").write_text(f"{CODE}\nCHANGED = True\n")
    shown = poise("profile", "show", "robot.yaml", "--history")
    assert shown.returncode == 0, shown.stderr
    assert "changed since it was measured: eye" in " ".join(shown.stdout.split())
    as_json = poise("profile", "show", "robot.yaml", "--json")
    assert set(json.loads(as_json.stdout)["components"]) == set(profile.components)
