"""Commands find the leader of a robot from each of its computers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.emulate import Emulation
from poise.session.keys import init_keys
from tests.command import POISE
from tests.session.conftest import bare_computers
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(LONG)]

NAMES = ("left", "right", "third")
CODE = """
from poise import Component, every

class Ticker(Component):
    @every(0.1)
    def tick(self):
        pass
"""
FILE = """
robot: {name}
computers:
{computers}
manager: [left, right]
architectures:
  work:
    function: work
    components:
      ticker: {{implementation: "any_computer:Ticker", cpu: 1%, memory: 20 MiB}}
  more:
    function: more
    components:
      other: {{implementation: "any_computer:Ticker", cpu: 1%, memory: 20 MiB}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
  more: {{actions: [{{name: more, functions: [more]}}]}}
"""


class Field:
    """Three computers, each with an agent and a runtime folder of its own."""

    def __init__(self, emulation: Emulation, folder: Path) -> None:
        self.name = f"any{os.getpid()}"
        self.computers = emulation.computers
        self.folder = folder
        authority = init_keys(self.name, folder / "owner")
        for name in NAMES:
            keys = authority.issue(name, "agent", folder / "keys" / name)
            authority.issue(name, "manager", keys.to_lead)
            words = ["agent", name, "--robot", self.name, "--keys", str(keys.folder)]
            words += ["--address", self.computers[name].address, "--allow", "/"]
            self.popen(name, *words, "--folder", str(self.computers[name].folder))
        (folder / "any_computer.py").write_text(CODE)
        computers = "\n".join(
            f'  {n}: {{cpu: 0.5, memory: 512 MB, address: "{c.address}"}}'
            for n, c in self.computers.items()
        )
        self.file = folder / "robot.yaml"
        self.file.write_text(FILE.format(name=self.name, computers=computers))

    def runtime(self, computer: str) -> Path:
        folder = self.folder / "runtime" / computer
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def popen(
        self, computer: str, *words: str, stdout: int | None = None, keys: str = ""
    ) -> subprocess.Popen[bytes]:
        env = {**os.environ, "XDG_RUNTIME_DIR": str(self.runtime(computer))}
        env |= {"XDG_STATE_HOME": env["XDG_RUNTIME_DIR"], "POISE_KEYS": keys}
        return self.computers[computer].popen(
            [*POISE, *words], env=env, stdout=stdout, stderr=stdout
        )

    def poise(self, computer: str, *words: str) -> tuple[int, str]:
        """Run a command on a computer; return its exit code and what it prints."""
        with self.popen(computer, *words, stdout=subprocess.PIPE) as process:
            said, error = process.communicate(timeout=LONG)
        return process.returncode, (said + error).decode()

    def has_socket(self) -> bool:
        """Return whether the manager on `left` takes commands."""
        return any(self.runtime("left").rglob("*.sock"))

    def crash(self, computer: str) -> None:
        for pid in self.computers[computer].running():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Field]:
    # the paths of sockets are short: a path of pytest's may be too long for them
    with (
        tempfile.TemporaryDirectory(prefix="any-") as folder,
        bare_computers(NAMES, tmp_path) as emulation,
    ):
        yield Field(emulation, Path(folder))


def test_commands_find_the_leader_from_each_computer(field: Field) -> None:
    keys = str(field.folder / "owner")
    words = ["up", str(field.file), "--task", "work"]
    with field.popen("left", *words, keys=keys), contextlib.ExitStack() as ends:
        ends.callback(field.crash, "left")
        # each `status` takes a computer of half a core most of a second
        wait_long(field.has_socket)
        wait_long(lambda: all(field.poise(name, "status")[0] == 0 for name in NAMES))
        assert field.poise("third", "move", "ticker", "third")[0] == 0
        code, said = field.poise("third", "move", "tickler", "left")
        assert code == 2
        assert "'tickler' is not running (running: ticker)" in said
        assert field.poise("right", "task", "start", "more")[0] == 0

        field.crash("left")
        code, said = field.poise("third", "move", "ticker", "right")
        assert code == 0, said
        code, said = field.poise("right", "status")
        assert "task 'more'" in said
        assert field.poise("third", "stop")[0] == 1  # its own computer is missing
    notes = [*field.runtime("third").rglob("*.agents")]
    wait_long(lambda: not notes or not notes[0].exists())
    code, said = field.poise("third", "status")
    assert code == 2
    assert "does not run" in said or "no robot runs" in said
