"""An agent of root's runs its containers as a user who can do less (`--run-as`)."""

from __future__ import annotations

import contextlib
import json
import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import poise
from poise.clock import SystemClock
from poise.errors import UsageError
from poise.runtime.agent.agent_files import CheckpointFiles
from poise.runtime.container.account import Account, rights_of
from poise.runtime.container.agent_link import Orphan, hand_over
from poise.runtime.execution.counters import new_memory
from poise.runtime.supervision.adopted_containers import AdoptedContainers
from poise.session.keys import init_keys
from poise.wire.address import agent_path
from poise.wire.records.request_records import CheckpointCopy, checkpoint_path
from tests.command import POISE
from tests.runtime.conftest import free_port
from tests.waiting import LONG, wait_long

pytestmark = pytest.mark.skipif(os.getuid() != 0, reason="only root may be another")

USER = "nobody"
NAMES = "left", "right"
CODE = """
import json, os, resource
import msgspec
from poise import Component, Message, Published, every, subscribed

def refused(act, *words):
    try:
        act(*words)
    except PermissionError:
        return True
    return False

class State(msgspec.Struct):
    seen: int = 0

class Spy(Component):
    numbers: Published[State]

    def configure(self):
        self.state = State()
        facts = {
            "ids": [*os.getresuid(), *os.getresgid()],
            "groups": os.getgroups(),
            "home": os.environ["HOME"],
            "status": open("/proc/self/status").read(),
            "nice": min(os.getpriority(os.PRIO_PROCESS, int(thread))
                        for thread in os.listdir("/proc/self/task")),
            "least": 20 - resource.getrlimit(resource.RLIMIT_NICE)[0],
            "refused": {
                "keys": all(refused(open, path) for path in self.parameters["secrets"]),
                "code": refused(open, __file__, "a"),
                "agent": all(refused(open, p) for p in self.parameters["agent"]),
                "root": refused(os.setuid, 0),
            },
        }
        with open(self.parameters["told"] + ".spy", "w") as file:
            json.dump({**facts, "pid": os.getpid()}, file)

    def snapshot(self):
        return self.state

    def restore(self, state: State):
        self.state = state

    @every(0.02)
    def look(self):
        self.state.seen += 1
        self.numbers.publish(State(self.state.seen))

class Sink(Component):
    @subscribed(keep=100)
    def numbers(self, message: State):
        path = self.parameters["told"]
        with open(path + ".new", "w") as file:
            json.dump({"seen": message.seen, "pid": os.getpid()}, file)
        os.replace(path + ".new", path)
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:{left}"}}
  right: {{cpu: 1, memory: 1 GiB, address: "127.0.0.1:{right}"}}
devices: {{wall: {{computer: right}}}} # else a slow machine starts the sink elsewhere
architectures:
  spy:
    function: spy
    home: left
    components:
      spy:
        implementation: "spy_of_test:Spy"
        cpu: 5%
        memory: 30 MiB
        checkpoint: 100 ms
        parameters: {{told: "{told}", secrets: {secrets}, agent: {agent}}}
  sink:
    function: sink
    home: right
    components:
      sink:
        implementation: "spy_of_test:Sink"
        devices: [wall]
        cpu: 5%
        memory: 30 MiB
        parameters: {{told: "{told}"}}
connectors:
  - {{between: [spy.numbers, sink.numbers], message: 20 B, rate: 50 Hz}}
tasks:
  spy: {{actions: [{{name: spy, functions: [spy, sink]}}]}}
"""


SHOW = """
mkdir -p "$1"
mount --bind "$0" "$1"
mount -t tmpfs -o mode=755 none "/$(echo "$0" | cut -d / -f 2)"
mkdir -p "$0"
mount --move "$1" "$0"
shift
exec "$@"
"""
"""Lets all users read the Python that runs the tests, though it is in root's home."""


def make_folder() -> Path:
    """Make a folder that all can enter."""
    folder = Path(tempfile.mkdtemp(prefix="poise-guests-"))
    for each in (folder, folder.parent):
        each.chmod(each.stat().st_mode | 0o055)
    return folder


def is_readable(folder: Path) -> bool:
    """Return whether `USER` can read a folder."""
    with contextlib.suppress(PermissionError), rights_of(Account.of(USER)):
        return bool(next(folder.iterdir(), None))
    return False


class Guests:
    """Two computers whose agents are root, and run containers as `USER`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.name = f"guests{os.getpid()}"
        self.told = folder / "told" / "sink"
        self.told.parent.mkdir()
        self.told.parent.chmod(0o777)  # both users write there
        self.authority = init_keys(self.name, folder / "owner")
        self.entering: Sequence[str] = ()
        if not is_readable(Path(sys.base_prefix)):
            if subprocess.run(["unshare", "-m", "true"], check=False).returncode:
                pytest.skip(f"user {USER} cannot read {sys.base_prefix}")
            argv = ["unshare", "-m", "sh", "-ec", SHOW, sys.base_prefix]
            self.entering = [*argv, str(folder / "python")]
        self.agents: dict[str, subprocess.Popen[bytes]] = {}
        self.ports = {name: free_port() for name in NAMES}
        self.file = folder / "source" / "robot.yaml"
        self.file.parent.mkdir()
        (self.file.parent / "spy_of_test.py").write_text(CODE)
        for name in NAMES:
            self.authority.issue(name, "agent", folder / "keys" / name)
        keys = folder / "keys" / "left"
        self.file.write_text(
            FILE.format(
                name=self.name,
                told=self.told,
                secrets=json.dumps([str(path) for path in keys.iterdir()]),
                agent=json.dumps([str(folder / "left" / n) for n in ("lock", "state")]),
                **self.ports,
            )
        )

    def start_agent(self, name: str) -> None:
        words = ["agent", name, "--robot", self.name, "--address", "127.0.0.1"]
        words += ["--port", str(self.ports[name]), "--allow", "deployed"]
        words += ["--keys", str(self.folder / "keys" / name), "--run-as", USER]
        words += ["--folder", str(self.folder / name)]
        self.agents[name] = subprocess.Popen(
            [*self.entering, *POISE, *words], env=self.env()
        )

    def env(self) -> dict[str, str]:
        home = str(self.folder / "home")
        return {
            **os.environ,
            "POISE_KEYS": str(self.folder / "owner"),
            "XDG_STATE_HOME": home,
            "XDG_RUNTIME_DIR": home,
        }

    def poise(self, *words: str) -> str:
        done = subprocess.run(
            [*POISE, *words],
            env=self.env(),
            capture_output=True,
            text=True,
            timeout=LONG,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def news(self, suffix: str = "") -> Any:
        """Return what a component has written last; None: nothing yet."""
        with contextlib.suppress(FileNotFoundError, json.JSONDecodeError):
            return json.loads(Path(f"{self.told}{suffix}").read_text())
        return None


@pytest.fixture
def guests(nobody: Account) -> Iterator[Guests]:
    """Start them in a folder that all can enter, unlike pytest's own."""
    del nobody
    folder = make_folder()
    guests = Guests(folder)
    for name in NAMES:
        guests.start_agent(name)
    try:
        yield guests
    finally:
        for agent in guests.agents.values():
            agent.terminate()
        for agent in guests.agents.values():
            agent.wait(LONG)
        shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.timeout(2 * LONG)
def test_containers_cannot_read_the_agents_keys(guests: Guests) -> None:
    """They move, keep checkpoints, and speak TLS all the same."""
    entry = pwd.getpwnam(USER)
    guests.poise("deploy", str(guests.file))
    words = ["up", str(guests.file), "--task", "spy", "--placement", "static"]
    with subprocess.Popen([*POISE, *words], env=guests.env()) as manager:
        try:
            wait_long(guests.news)
            facts = guests.news(".spy")
            assert facts["ids"] == [entry.pw_uid] * 3 + [entry.pw_gid] * 3
            assert 0 not in facts["groups"]
            assert facts["home"] == entry.pw_dir
            assert "NoNewPrivs:\t1" in facts["status"]
            assert "CapEff:\t0000000000000000" in facts["status"]
            own = os.nice(0)
            assert facts["nice"] == min(own, max(facts["least"], own - 10))
            assert facts["refused"] == dict.fromkeys(facts["refused"], True)
            moved = guests.news()["seen"]
            guests.poise("move", "spy", "right")
            wait_long(lambda: guests.news(".spy")["pid"] != facts["pid"])
            wait_long(lambda: guests.news()["seen"] > moved + 20)
            time.sleep(1.0)  # the agent has seen a checkpoint by then
            os.kill(guests.news(".spy")["pid"], signal.SIGKILL)
            wait_long(
                lambda: "'spy' restarts with its state" in guests.poise("journal")
            )
            before = guests.news()
            guests.agents["right"].kill()
            guests.agents["right"].wait()
            guests.start_agent("right")
            wait_long(lambda: guests.news()["seen"] > before["seen"] + 100)
            assert guests.news()["pid"] == before["pid"]  # it was adopted
        finally:
            manager.terminate()
            manager.wait(LONG)


@pytest.fixture
def nobody() -> Account:
    if not is_readable(Path(poise.__file__).parent):
        pytest.skip(f"user {USER} cannot read this clone")
    return Account.of(USER)


@pytest.fixture
def shared(nobody: Account) -> Iterator[Path]:
    """Return the folder of an agent's containers."""
    folder = make_folder()
    (folder / "run").mkdir()
    os.chown(folder / "run", nobody.user, nobody.group)
    yield folder / "run"
    shutil.rmtree(folder)


def test_the_agent_follows_no_link_of_a_component(
    nobody: Account, shared: Path, tmp_path: Path
) -> None:
    (tmp_path / "secret").write_text("of root")
    copy = CheckpointCopy(component="a", epoch=1, data=b"forged", age=0.0)
    link = checkpoint_path(shared, "a", 1)
    draft = link.with_suffix(".new")
    for each in (link, draft):
        each.symlink_to(tmp_path / "secret")
    files = CheckpointFiles(shared, lambda _: None, nobody)
    with rights_of(nobody):
        with pytest.raises(PermissionError):
            files.write(copy)
        draft.unlink(missing_ok=True)
        files.write(copy)
    assert not link.is_symlink()
    assert link.stat().st_uid == nobody.user
    assert (tmp_path / "secret").read_text() == "of root"


@pytest.mark.slow
def test_a_process_of_another_user_is_not_adopted(
    nobody: Account, shared: Path
) -> None:
    """A component might name any, and the agent would end that later."""
    adoption = AdoptedContainers(shared, SystemClock(), nobody)
    with contextlib.closing(adoption), contextlib.ExitStack() as closing:
        asking = closing.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        asking.connect(os.fspath(agent_path(shared)))
        page = new_memory()
        closing.callback(os.close, page)
        orphan = Orphan(container="forged", pid=os.getpid())
        closing.enter_context(hand_over(asking, orphan, page))
        assert adoption.next_orphan() is None
        assert not adoption.pidfds()


def test_a_folder_of_somebody_else_is_refused(nobody: Account, shared: Path) -> None:
    with pytest.raises(UsageError, match="must be root's: choose another folder"):
        nobody.make_folder(shared / "run")


def test_a_user_who_is_not_there_or_is_root_is_refused() -> None:
    with pytest.raises(UsageError, match="no such user: `useradd --system nemo`"):
        Account.of("nemo")
    with pytest.raises(UsageError, match="choose a user who is not root"):
        Account.of("root")
