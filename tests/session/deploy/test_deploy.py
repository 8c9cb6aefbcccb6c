"""Code reaches two computers with keys, and they run what was deployed to them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise.emulate import Emulation, probe_host
from poise.model.robot import Computer, Robot
from poise.session.keys import init_keys
from tests.command import POISE
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

NAMES = ("left", "right")
CODE = """
import msgspec
from poise import Component, every

class State(msgspec.Struct):
    ticks: int = 0

class Ticker(Component):
    def configure(self):
        self.state = State()
        print(f"{VERSION} of {__file__}")

    def snapshot(self):
        return self.state

    def restore(self, state: State):
        self.state = state
        print(f"{VERSION} goes on after {state.ticks > 0}")

    @every(0.1)
    def tick(self):
        self.state.ticks += 1
"""
FILE = """
robot: {name}
computers:
{computers}
architectures:
  work:
    function: work
    components:
      ticker: {{implementation: "deployed_ticker:Ticker", cpu: 1%, memory: 20 MiB}}
tasks:
  work: {{actions: [{{name: work, functions: [work]}}]}}
"""


class Field:
    """Two computers with an agent each, and their owner on the first one."""

    def __init__(self, emulation: Emulation, folder: Path) -> None:
        self.name = f"field{os.getpid()}"
        self.computers = emulation.computers
        self.folder = folder
        self.source = folder / "source"
        self.source.mkdir()
        self.authority = init_keys(self.name, folder / "owner")
        computers = "\n".join(
            f'  {n}: {{cpu: 1, memory: 1 GiB, address: "{c.address}"}}'
            for n, c in self.computers.items()
        )
        self.file = self.source / "robot.yaml"
        self.file.write_text(FILE.format(name=self.name, computers=computers))
        self.write_code("first")
        for name in NAMES:
            self.start_agent(name)

    def write_code(self, version: str, more: str = "") -> None:
        text = f'VERSION = "{version}"\n{CODE}{more}'
        (self.source / "deployed_ticker.py").write_text(text)

    def start_agent(self, name: str) -> subprocess.Popen[bytes]:
        keys = self.folder / "keys" / name
        if not keys.exists():
            self.authority.issue(name, "agent", keys)
        words = ["agent", name, "--robot", self.name, "--keys", str(keys)]
        words += ["--address", self.computers[name].address]
        folder = self.computers[name].folder
        return self.popen(name, *words, "--folder", str(folder))

    def code(self, name: str) -> Path:
        return self.computers[name].folder / "code"

    def popen(
        self, computer: str, *words: str, stdout: int | None = None
    ) -> subprocess.Popen[bytes]:
        home = self.folder / "home" / computer
        home.mkdir(parents=True, exist_ok=True)
        env = {**os.environ, "XDG_RUNTIME_DIR": str(home), "XDG_STATE_HOME": str(home)}
        env["POISE_KEYS"] = str(self.folder / "owner")
        return self.computers[computer].popen(
            [*POISE, *words], env=env, stdout=stdout, stderr=stdout
        )

    def poise(self, *words: str) -> tuple[int, str]:
        """Run a command on the first computer; return its exit code and its words."""
        with self.popen("left", *words, stdout=subprocess.PIPE) as process:
            said, error = process.communicate(timeout=LONG)
        return process.returncode, (error + said).decode()

    def deploy(self) -> str:
        """Deploy what is written; return the version."""
        code, said = self.poise("deploy", str(self.file), "--json")
        assert code == 0, said
        version: str = json.loads(said.splitlines()[-1])["version"]
        return version

    @contextlib.contextmanager
    def up(self) -> Iterator[None]:
        with self.popen("left", "up", str(self.file), "--task", "work") as process:
            try:
                wait_long(lambda: self.poise("status")[0] == 0)
                yield
            finally:
                self.poise("stop")
                process.send_signal(signal.SIGTERM)

    def log(self) -> str:
        return self.poise("log", "ticker")[1]


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Field]:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    computers = tuple(
        Computer(name=name, capacity={"cpu": 0.5, "memory": 512e6}) for name in NAMES
    )
    with Emulation(Robot(name="field", computers=computers), tmp_path) as emulation:
        yield Field(emulation, tmp_path)


def test_computers_run_only_what_was_deployed(field: Field) -> None:
    code, said = field.poise("up", str(field.file))
    assert code != 0
    assert f"is at {field.source}, and this agent only runs what is deployed" in said
    first = field.deploy()
    assert field.deploy() == first
    assert [path.name for path in field.code("right").iterdir()] == [first]
    with field.up():
        place = field.code("left") / first / "code/deployed_ticker.py"
        assert f"first of {place}" in field.log()

        field.write_code("second")
        second = field.deploy()
        assert second != first
        assert "second of" not in field.log()
    with field.up():
        place = field.code("left") / second / "code/deployed_ticker.py"
        assert f"second of {place}" in field.log()
    field.write_code("third")
    code, said = field.poise("up", str(field.file))
    assert code == 2
    assert "is not on left, right: run `poise deploy FILE`" in said


def test_a_computer_that_is_lost_meanwhile_keeps_what_it_has(field: Field) -> None:
    first = field.deploy()
    field.write_code("second", f"DATA = {'x' * 20_000_000!r}\n")
    agents = list(field.computers["right"].running())
    with field.popen("left", "deploy", str(field.file), stdout=subprocess.PIPE) as it:
        wait_long(lambda: bool([*field.code("right").glob("*.part")]))
        for pid in agents:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        said = it.communicate(timeout=LONG)[1].decode()
    assert it.returncode == 1
    assert "'right' has " in said
    assert "runs what it ran: its agent did not answer" in said
    field.start_agent("right")
    wait_long(lambda: not [*field.code("right").glob("*.part")])
    assert [path.name for path in field.code("right").iterdir()] == [first]
    second = field.deploy()
    assert {path.name for path in field.code("right").iterdir()} == {first, second}
