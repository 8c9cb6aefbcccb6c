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

from poise.emulate import Emulation
from poise.session.keys import init_keys
from tests.command import POISE
from tests.session.conftest import bare_computers
from tests.tiny_wheel import make_wheel
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(LONG)]

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

    @every(0.1, deadline=0.1)
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


def crash_at(tick: int) -> str:
    """Return code for the end of the timer, which ends the process some time."""
    lines = (
        "self.own_ticks = getattr(self, 'own_ticks', 0) + 1",
        f"if self.own_ticks == {tick}:",
        "    __import__('os')._exit(3)",
    )
    return "".join(f"        {line}\n" for line in lines)


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
            f'  {n}: {{cpu: 0.5, memory: 512 MB, address: "{c.address}"}}'
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
        if words[0] != "agent":  # what the developer has, the computers have not
            env |= {"PYTHONPATH": str(self.folder / "installed"), "PIP_NO_INDEX": "1"}
            env["PIP_FIND_LINKS"] = str(self.folder / "index")
            env["XDG_CACHE_HOME"] = str(home)
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
    def up(self) -> Iterator[subprocess.Popen[bytes]]:
        with self.popen("left", "up", str(self.file), "--task", "work") as process:
            try:
                wait_long(lambda: self.poise("status")[0] == 0)
                yield process
            finally:
                self.poise("stop")
                process.send_signal(signal.SIGTERM)

    def log(self) -> str:
        return self.poise("log")[1]


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Field]:
    with bare_computers(NAMES, tmp_path) as emulation:
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


def test_wheels_come_along(field: Field) -> None:
    (field.folder / "installed").mkdir()
    (field.folder / "installed/tiny.py").write_text("VERSION = 'the developer has'")
    (field.source / "requirements.txt").write_text("tiny")
    make_wheel(field.folder / "index", "1.5")
    field.write_code("first", "import tiny\nVERSION += tiny.VERSION")
    version = field.deploy()
    assert (
        "tiny-1.5-py3-none-any.whl" in (field.source / "requirements.lock").read_text()
    )
    assert (field.code("right") / version / "packages/tiny.py").exists()
    with field.up():
        assert "first1.5 of " in field.log()


def test_it_is_said_that_native_code_is_for_another_machine(field: Field) -> None:
    (field.source / "lens.abi3.so").write_bytes(
        b"\x7fELF\2\1".ljust(18, b"\0") + b"\x4b\0"
    )
    field.write_code("first", "def look():\n    import lens")
    code, said = field.poise("deploy", str(field.file))
    assert code == 0, said
    for name in NAMES:
        assert f"{name} is {os.uname().machine} with Python 3." in said
    assert said.count(", and cannot run lens, which is for machine 75: build it") == 2


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


def test_new_code_of_one_component_takes_its_state_and_comes_back_when_it_crashes(
    field: Field,
) -> None:
    first = field.deploy()
    with field.up():
        field.write_code("second")
        second = field.deploy()
        by = f"deployed_ticker:Ticker@{second[:12]}"
        code, said = field.poise("replace", "ticker", by, "--watch", "1s")
        assert code == 0, said
        assert "second goes on after True" in field.log()
        wait_long(lambda: "worked for 1 s: it stays" in field.poise("journal")[1])

        field.write_code("third", crash_at(40))
        third = field.deploy()
        by = f"deployed_ticker:Ticker@{third[:12]}"
        code, said = field.poise("replace", "ticker", by, "--watch", "60s")
        assert code == 0, said
        watched = "new code of component 'ticker' is watched for 5"
        wait_long(lambda: watched in field.poise("status")[1])
        returned = "component 'ticker' returns to its previous code: its container"
        wait_long(lambda: returned in field.poise("status")[1])
        wait_long(lambda: field.log().count("second of") >= 2)
        assert returned in field.poise("journal")[1]
        assert {first, second, third} == {p.name for p in field.code("left").iterdir()}


def test_the_next_manager_goes_on_with_new_code(field: Field) -> None:
    field.deploy()
    with field.up() as manager:
        field.write_code("second")
        by = f"deployed_ticker:Ticker@{field.deploy()[:12]}"
        assert field.poise("replace", "ticker", by)[0] == 0
        manager.kill()
        manager.wait()
        field.write_code("first")  # what the robot runs but for one component
        with field.up():
            assert "going on with 1 component" in field.poise("journal")[1]
            assert field.log().count(" of /") == 2


def test_new_code_that_crashes_at_once_comes_back(field: Field) -> None:
    field.deploy()
    with field.up():
        field.write_code("second", crash_at(1))
        by = f"deployed_ticker:Ticker@{field.deploy()[:12]}"
        assert field.poise("replace", "ticker", by, "--watch", "60s")[0] == 0
        wait_long(lambda: field.log().count("first of") >= 2)
        wait_long(lambda: "watched" not in field.poise("status")[1])
        assert "returns to its previous code" in field.poise("journal")[1]


def test_new_code_that_misses_deadlines_comes_back_with_its_state(
    field: Field,
) -> None:
    field.deploy()
    with field.up():
        field.write_code("slow", "        __import__('time').sleep(0.15)\n")
        slow = field.deploy()
        by = f"deployed_ticker:Ticker@{slow[:12]}"
        assert field.poise("replace", "ticker", by, "--watch", "60s")[0] == 0
        wait_long(lambda: "first goes on after True" in field.log())
        assert "timer 'tick' missed" in field.poise("journal")[1]


def test_a_version_that_is_not_there_is_refused(field: Field) -> None:
    field.deploy()
    with field.up():
        by = "deployed_ticker:Ticker@0123"
        code, said = field.poise("replace", "ticker", by)
        assert code == 2
        assert "has no version of the code that begins with" in said
