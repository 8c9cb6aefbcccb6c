"""The agent, its zygote and its containers: real processes, and a manager's view."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count, islice
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh
from msgspec import structs

from poise.decoding import from_msgpack
from poise.runtime.agent.surroundings import BROKEN, AgentState
from poise.waker import wait_readable
from poise.wire.address import agent_path
from poise.wire.codec import pack
from poise.wire.control_session import open_session
from poise.wire.records.deployment_records import (
    ComponentSpec,
    ConnectorSpec,
    ContainerSpec,
    Deployment,
    Goal,
)
from poise.wire.records.migration_records import MigrationSteps, Step, StepsFailed
from poise.wire.records.request_records import (
    LEAST_PROTOCOL,
    PROTOCOL,
    Accepted,
    Answer,
    Claim,
    Claimed,
    ManagerId,
    ManagerRequest,
    PortRequest,
    ReadOutput,
    Refused,
    Request,
)
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    ContainerStatus,
    Fault,
)
from tests.processes import children_of
from tests.runtime.conftest import free_port
from tests.waiting import LIMIT, wait_until

pytestmark = pytest.mark.slow

MODULE = '''
import ctypes, os, pathlib, signal, subprocess, sys, time
os.chdir(os.path.dirname(__file__))
from poise import Component, Message, Published, every

class Quiet(Component): pass

class Calm(Component): pass

class Speaking(Component):
    said: Published[Message]

class Angry(Component):
    def configure(self):
        raise LookupError("no map here")

class Suicidal(Component):
    def activate(self):
        os.kill(os.getpid(), signal.SIGSEGV)

class Busy(Component):
    @every(0.05)
    def work(self):
        until = time.thread_time() + 0.01
        while time.thread_time() < until: pass

class Forking(Component):
    # one child is in its process group, one has a session and no parent of its own
    def activate(self):
        for leave in (False, True):
            if os.fork() == 0:
                if leave:
                    os.setsid()
                    if os.fork():
                        os._exit(0)
                    pathlib.Path("daemon").write_text(str(os.getpid()))
                signal.pause()
                os._exit(0)

class Daemonizing(Component):
    """Starts two programs, and a daemon that ends once its parent has."""

    def activate(self):
        self.own = [
            subprocess.Popen(["sh", "-c", f"exit {code}"], start_new_session=code == 4)
            for code in (3, 4)
        ]
        if os.fork() == 0:
            os.setsid()
            parent = os.getpid()
            if os.fork():
                os._exit(0)
            while os.getppid() == parent:
                time.sleep(0.001)
            pathlib.Path("orphan").write_text(str(os.getpid()))
            os._exit(0)

    @every(0.01)
    def look(self):
        if os.path.exists("look") and not os.path.exists("codes"):
            codes = [each.wait() for each in self.own]
            pathlib.Path("codes").write_text(str(codes))

class Greedy(Component):
    def activate(self):
        ctypes.PyDLL(None).sleep(1000)  # with the GIL

class Parking(Component):
    def deactivate(self):
        time.sleep(2.5)

    def cleanup(self):
        time.sleep(0.5)
        pathlib.Path("parked").touch()

class Messy(Component):
    def cleanup(self):
        raise OSError("the map cannot be saved")

class Stubborn(Component):
    def deactivate(self):
        while True: pass
'''


def manager_id(key: str) -> ManagerId:
    return ManagerId(key=key, user="ann", host="desk", pid=7, since=0.0)


SLOW_MODULE = """
import os, time
from poise import Component
while not os.path.exists(os.path.join(os.path.dirname(__file__), "go_on")):
    time.sleep(0.01)

class Slow(Component): pass
"""


BROKEN_LOOP = """
import os
from poise.runtime.agent import core

before = core.AgentCore.tick

def tick(self):
    if os.path.exists(os.path.join(self._setup.folder, "break")):
        raise KeyError("a bug")
    before(self)

core.AgentCore.tick = tick
"""


class Manager:
    """What a manager sees of one agent, and asks of it."""

    def __init__(self, folder: Path) -> None:
        (folder / "quiet_module.py").write_text(MODULE)
        self.folder = folder
        self._port = free_port()
        self._changed = threading.Condition()
        self._status: AgentStatus | None = None
        self._known_faults = 0
        self._generation = 0
        self.token = 1
        self.lifeline, self._held = os.pipe()
        self.process = self.start_agent()
        self._session = open_session(connect=[f"tcp/127.0.0.1:{self._port}"])
        self._subscriber = self._session.declare_subscriber(
            "poise/test/status/main", self._on_status
        )
        self.wait_for(lambda _: True)
        assert isinstance(self.ask(Claim(manager_id("first"))), Claimed)

    def start_agent(self, *extra: str) -> subprocess.Popen[str]:
        argv = [sys.executable, "-m", "poise", "agent", "main", "--robot", "test"]
        argv += ["--address", "127.0.0.1", "--port", str(self._port)]
        argv += ["--folder", str(self.folder), "--lifeline", str(self.lifeline), *extra]
        return subprocess.Popen(
            argv, pass_fds=[self.lifeline], stderr=subprocess.PIPE, text=True
        )

    def ask(self, request: Request, token: int | None = None) -> Any:
        token = self.token if token is None else token
        asked = ManagerRequest(token=token, request=request)
        return self.ask_raw(msgspec.msgpack.encode(asked))

    def ask_raw(self, data: bytes) -> Any:
        key = "poise/test/agent/main"
        for reply in self._session.get(key, payload=data, timeout=LIMIT):
            assert reply.ok is not None
            return msgspec.msgpack.decode(reply.ok.payload.to_bytes(), type=Answer)
        pytest.fail("the agent did not answer")

    def deploy(self, *names: str, goal: Goal = "active", **more: Any) -> None:
        """Let a container of its own run for each class named in `MODULE`."""
        self._deploy(*(self._container(name, goal, more) for name in names))

    def deploy_container(self, name: str, *components: ComponentSpec) -> None:
        """Let one container run with these components."""
        self._deploy(self._with(name, *components))

    def _deploy(self, *containers: ContainerSpec) -> None:
        self._generation += 1
        wanted = Deployment(generation=self._generation, containers=containers)
        assert self.ask(wanted) == Accepted()

    def wait_for(self, what: Callable[[AgentStatus], bool]) -> AgentStatus:
        """Wait until a status of the present generation is as asked."""

        def holds() -> bool:
            status = self._status
            if status is None or status.generation < self._generation:
                return False
            return what(status)

        with self._changed:
            assert self._changed.wait_for(holds, LIMIT), self._status
            assert self._status is not None
            return self._status

    def wait_active(self, name: str, but_not: int = 0) -> ContainerStatus:
        """Wait until a container runs, in another process than `but_not`."""
        status = self.wait_active_status(name, but_not)
        return next(c for c in status.containers if c.name == name)

    def wait_active_status(self, name: str, but_not: int = 0) -> AgentStatus:

        def runs(status: AgentStatus) -> bool:
            return any(
                c.name == name
                and c.pid != but_not
                and c.components[0].state == "active"
                for c in status.containers
            )

        return self.wait_for(runs)

    def wait_agent(self) -> AgentStatus:
        """Wait for the first status of the agent that was started last."""
        self._generation = 0
        return self.wait_for(lambda status: status.pid == self.process.pid)

    def wait_adopted(self, name: str) -> ContainerStatus:
        """Wait until the agent that was started last has adopted a container."""
        status = self.wait_for(
            lambda status: (
                status.pid == self.process.pid
                and any(each.name == name for each in status.containers)
            )
        )
        assert status.took_over
        return next(each for each in status.containers if each.name == name)

    def wait_kept(self) -> None:
        """Wait until the agent has written down what was deployed last, if anything."""

        def is_kept() -> bool:
            state = AgentState()
            with contextlib.suppress(FileNotFoundError):
                state = from_msgpack((self.folder / "state").read_bytes(), AgentState)
            wanted = state.wanted
            return wanted is not None and wanted.generation >= self._generation

        if self._generation:
            wait_until(is_kept)

    def forget_faults(self) -> None:
        """Let `faults` give only those that follow."""
        self._known_faults = max((f.number for f in self._now().faults), default=0)

    def faults(self, status: AgentStatus | None = None) -> list[Fault]:
        faults = (status or self._now()).faults
        return [f for f in faults if f.number > self._known_faults]

    def _now(self) -> AgentStatus:
        return self.wait_for(lambda _: True)

    def cut_lifeline(self) -> None:
        if self._held >= 0:
            os.close(self._held)
            self._held = -1

    def close(self) -> None:
        self.cut_lifeline()
        self._session.close()  # type: ignore[no-untyped-call]
        try:
            self.process.wait(LIMIT)
        finally:
            self.process.kill()
            self.process.communicate(timeout=LIMIT)
            os.close(self.lifeline)

    def _container(self, name: str, goal: Goal, more: dict[str, Any]) -> ContainerSpec:
        reference = more.get("implementation", f"quiet_module:{name.capitalize()}")
        command = more.get("command", ())
        component = ComponentSpec(
            name=name,
            goal=goal,
            implementation="" if command else reference,
            command=command,
        )
        return self._with(name, component)

    def _with(self, name: str, *components: ComponentSpec) -> ContainerSpec:
        return ContainerSpec(
            name=name,
            folder=str(self.folder),
            components=components,
            connectors=(),
        )

    def _on_status(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self._status = msgspec.msgpack.decode(
                sample.payload.to_bytes(), type=AgentStatus
            )
            self._changed.notify_all()


def _managers() -> Iterator[Manager]:
    with tempfile.TemporaryDirectory() as folder:  # pytest's are too long for sockets
        manager = Manager(Path(folder))
        yield manager
        manager.close()


_shared = pytest.fixture(scope="module", name="_shared")(_managers)
doomed = pytest.fixture(name="doomed")(_managers)
"""A manager of an agent that the test may end."""


@pytest.fixture
def manager(_shared: Manager) -> Iterator[Manager]:
    """Share one agent: to start one takes a second; leave it as it was."""
    yield _shared
    _shared.deploy()
    _shared.wait_for(lambda status: not status.containers)
    _shared.forget_faults()


def wait_gone(pid: int) -> None:
    """Wait until a process, which need not be a child, has ended."""
    try:
        pidfd = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    assert wait_readable([pidfd], LIMIT)
    os.close(pidfd)


def health(status: AgentStatus, name: str) -> ContainerHealth:
    none = ContainerHealth(name=name, state="stopped", since=0.0)
    return next((h for h in status.health if h.name == name), none)


def states(status: AgentStatus) -> dict[str, str]:
    return {c.name: c.state for each in status.containers for c in each.components}


def only(status: AgentStatus) -> ComponentStatus:
    ((component,),) = (c.components for c in status.containers)
    return component


def test_runs_what_it_is_told_and_nothing_when_told_nothing(manager: Manager) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    assert container.pid not in {os.getpid(), manager.process.pid}
    manager.deploy()
    manager.wait_for(lambda status: not status.containers)
    wait_gone(container.pid)


def test_saying_a_thing_twice_is_harmless(manager: Manager) -> None:
    manager.deploy("quiet")
    first = manager.wait_active("quiet")
    manager.deploy("quiet")
    assert manager.wait_active("quiet").pid == first.pid


def test_heals_a_container_that_was_killed(manager: Manager) -> None:
    manager.deploy("quiet")
    first = manager.wait_active("quiet")
    # as `top` shows it
    assert Path(f"/proc/{first.pid}/comm").read_text() == "quiet\n"
    os.kill(first.pid, signal.SIGKILL)
    second = manager.wait_active("quiet", but_not=first.pid)
    assert second.pid != first.pid
    (fault,) = manager.faults()
    assert fault.container == "quiet"
    assert fault.message == "was killed by SIGKILL"
    assert abs(fault.at - time.time()) < LIMIT


def test_counts_restarts_and_keeps_the_last_fault_of_a_container(
    manager: Manager,
) -> None:
    manager.deploy("quiet")
    before = health(manager.wait_active_status("quiet"), "quiet").restarts
    pid = 0
    for _ in range(2):
        pid = manager.wait_active("quiet", but_not=pid).pid
        os.kill(pid, signal.SIGKILL)
    status = manager.wait_active_status("quiet", but_not=pid)
    now = health(status, "quiet")
    assert now.restarts == before + 2
    assert now.state == "running"
    assert now.last_fault == manager.faults(status)[-1]
    manager.deploy()
    status = manager.wait_for(
        lambda s: not s.containers and health(s, "quiet").state == "stopped"
    )
    assert health(status, "quiet").last_fault == now.last_fault


def test_says_what_computer_and_containers_use(manager: Manager) -> None:
    manager.deploy("busy")
    manager.wait_active("busy")
    status = manager.wait_for(lambda s: health(s, "busy").cpu > 0.1)
    assert health(status, "busy").memory > 1e6
    assert status.load >= health(status, "busy").cpu
    # the agent's own is read a little later
    manager.wait_for(lambda s: s.memory > health(s, "busy").memory)


def test_heals_one_that_breaks_again_and_again(manager: Manager) -> None:
    manager.deploy("suicidal", "quiet")
    manager.wait_for(lambda status: len(manager.faults(status)) >= 3)
    assert {f.message for f in manager.faults()} == {"was killed by SIGSEGV"}
    assert [f.restarts for f in manager.faults()][:3] == [0, 1, 2]
    manager.wait_active("quiet")
    manager.deploy()
    manager.wait_for(lambda status: not status.containers)


def test_tells_the_traceback_of_a_component_that_fails(manager: Manager) -> None:
    manager.deploy("angry")
    status = manager.wait_for(
        lambda s: bool(s.containers) and only(s).state == "failed"
    )
    assert "LookupError: no map here" in only(status).error


@pytest.mark.parametrize(
    ("reference", "says"),
    [
        ("no_such_module:Any", "there is no module 'no_such_module'"),
        ("quiet_module:Qiet", "has no class 'Qiet' (did you mean 'Quiet'?)"),
    ],
)
def test_tells_what_cannot_be_imported(
    manager: Manager, reference: str, says: str
) -> None:
    manager.deploy("quiet", implementation=reference)
    status = manager.wait_for(
        lambda s: bool(s.containers) and only(s).state == "failed"
    )
    assert says in only(status).error


def test_a_component_recovers_when_it_is_given_the_right_address(
    manager: Manager,
) -> None:
    wrong = ConnectorSpec(
        name="said",
        kind="remote",
        source="speaking",
        source_port="said",
        target="far",
        target_port="heard",
        address="nowhere/far",
    )
    for connector in (wrong, structs.replace(wrong, address="127.0.0.1:9/far")):
        spec = manager._container("speaking", "active", {})
        manager._deploy(structs.replace(spec, connectors=(connector,)))
        if connector == wrong:
            status = manager.wait_for(
                lambda s: bool(s.containers) and states(s) == {"speaking": "failed"}
            )
            assert "'nowhere/far' is not the address" in only(status).error
    assert manager.wait_active("speaking").components[0].error == ""


def test_a_component_that_could_not_start_is_tried_again_when_it_is_another(
    manager: Manager,
) -> None:
    manager.deploy("quiet", implementation="quiet_module:Quite")
    manager.wait_for(lambda s: states(s) == {"quiet": "failed"})
    manager.deploy("quiet")
    manager.wait_active("quiet")


def test_kills_one_that_will_not_end(manager: Manager) -> None:
    manager.deploy("stubborn")
    container = manager.wait_active("stubborn")
    manager.deploy()
    status = manager.wait_for(lambda status: not status.containers)
    wait_gone(container.pid)
    fault = status.faults[-1]
    said = "was ended: component 'stubborn' did not end in time: 'deactivate' has run"
    assert said in fault.message


def test_a_hook_that_fails_at_the_end_is_a_fault(manager: Manager) -> None:
    """Also of one whose container goes on."""
    specs = [
        ComponentSpec(
            name=name,
            goal="inactive",
            implementation=f"quiet_module:{name.capitalize()}",
        )
        for name in ("messy", "quiet")
    ]
    manager.deploy_container("both", *specs)
    manager.wait_for(lambda status: set(states(status).values()) == {"inactive"})
    manager.deploy_container("both", specs[1])
    said = "says that 'cleanup' of component 'messy' raised OSError: the map cannot be"

    def told(status: AgentStatus) -> int:
        return sum(fault.message.startswith(said) for fault in status.faults)

    manager.wait_for(lambda status: told(status) == 1 and "messy" not in states(status))
    manager.deploy_container("both", *specs)
    manager.wait_for(lambda status: states(status).get("messy") == "inactive")
    manager.deploy()
    status = manager.wait_for(lambda status: not status.containers)
    assert told(status) == 2


def test_waits_until_one_has_parked(manager: Manager) -> None:
    """Its last hook takes longer than a handler may."""
    manager.deploy("parking")
    container = manager.wait_active("parking")
    manager.deploy()
    status = manager.wait_for(lambda status: not status.containers)
    wait_gone(container.pid)
    assert (manager.folder / "parked").exists()
    assert "parking" not in [fault.container for fault in status.faults]


def test_runs_a_command_and_starts_it_anew_when_it_ends(manager: Manager) -> None:
    manager.deploy("sleeper", command=("sh", "-c", "sleep 0.1; exit 4"))
    manager.wait_for(lambda status: len(manager.faults(status)) >= 2)
    assert "its command ended with exit code 4" in manager.faults()[0].message
    manager.deploy()
    manager.wait_for(lambda status: not status.containers)


def test_a_command_that_is_made_inactive_ends_and_its_container_does_not(
    manager: Manager,
) -> None:
    command = ("sleep", "100")
    manager.deploy("sleeper", command=command)
    pid = manager.wait_active("sleeper").pid
    (process,) = children_of(pid)
    manager.deploy("sleeper", goal="inactive", command=command)
    status = manager.wait_for(
        lambda status: (
            [c.components[0].state for c in status.containers] == ["inactive"]
        )
    )
    wait_gone(process)
    assert [c.pid for c in status.containers] == [pid]
    assert manager.faults(status) == []
    manager.deploy("sleeper", command=command)
    assert manager.wait_active("sleeper").pid == pid


def test_ends_with_its_lifeline(doomed: Manager) -> None:
    doomed.deploy("quiet")
    container = doomed.wait_active("quiet")
    doomed.cut_lifeline()
    assert doomed.process.wait(LIMIT) == 0
    wait_gone(container.pid)


def test_a_command_ends_with_its_container(manager: Manager) -> None:
    manager.deploy("sleeper", command=("sleep", "100"))
    container = manager.wait_active("sleeper")
    (command,) = children_of(container.pid)
    os.kill(container.pid, signal.SIGKILL)
    wait_gone(command)


@pytest.mark.parametrize("how", ["killed", "stopped"])
def test_what_a_component_forked_ends_with_its_container(
    manager: Manager, how: str
) -> None:
    daemon = manager.folder / "daemon"
    daemon.unlink(missing_ok=True)
    manager.deploy("forking")
    container = manager.wait_active("forking")
    wait_until(lambda: daemon.exists() and daemon.read_text() != "")
    # its parent ends, and the container takes its place
    wait_until(lambda: int(daemon.read_text()) in children_of(container.pid))
    forked = children_of(container.pid)
    assert len(forked) >= 2
    if how == "killed":
        os.kill(container.pid, signal.SIGKILL)
    else:
        manager.deploy()
    for pid in forked:
        wait_gone(pid)


def test_an_orphan_that_ended_is_reaped_and_no_exit_code_is_lost(
    manager: Manager,
) -> None:
    orphan, codes = manager.folder / "orphan", manager.folder / "codes"
    manager.deploy("daemonizing")
    container = manager.wait_active("daemonizing")
    wait_until(lambda: orphan.exists() and orphan.read_text() != "")
    pid = int(orphan.read_text())
    wait_until(lambda: pid not in children_of(container.pid))
    (manager.folder / "look").touch()
    wait_until(lambda: codes.exists() and codes.read_text().endswith("]"))
    assert codes.read_text() == "[3, 4]"
    assert manager.wait_active("daemonizing").pid == container.pid


def test_a_stopped_container_is_told_within_a_second_or_so(manager: Manager) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    os.kill(container.pid, signal.SIGSTOP)
    status = manager.wait_for(lambda s: health(s, "quiet").state == "unresponsive")
    assert only(status).state == "unresponsive"
    (fault,) = manager.faults(status)
    assert "has not responded for" in fault.message
    assert "its process is stopped (SIGSTOP)" in fault.message
    steps = MigrationSteps(8, 1, "quiet", (Step("redirect", "x"),), limit=LIMIT)
    assert manager.ask(steps) == StepsFailed(
        8, "container 'quiet' does not respond: its process is stopped (SIGSTOP)"
    )
    os.kill(container.pid, signal.SIGCONT)
    status = manager.wait_for(lambda s: health(s, "quiet").state == "running")
    assert "responds again" in manager.faults(status)[-1].message
    assert manager.wait_active("quiet").pid == container.pid


def test_a_large_request_to_a_stopped_container_harms_nobody(manager: Manager) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")

    def request(number: int, value: Any) -> Any:
        request = PortRequest(
            number=number,
            container="quiet",
            component="quiet",
            port="no-port",
            method="",
            value=pack(value),
            limit=LIMIT,
        )
        return manager.ask(request)

    os.kill(container.pid, signal.SIGSTOP)
    failed = request(1, "x" * 5_000_000)
    assert isinstance(failed, StepsFailed)
    assert "does not respond" in failed.reason
    os.kill(container.pid, signal.SIGCONT)
    # the agent looks at the process's state from time to time
    numbers = count(2)
    wait_until(lambda: "has no port" in request(next(numbers), "x").reason, LIMIT)
    assert manager.wait_active("quiet").pid == container.pid


def test_an_interpreter_that_is_held_is_told(manager: Manager) -> None:
    manager.deploy("greedy")
    status = manager.wait_for(lambda s: health(s, "greedy").state == "unresponsive")
    assert "holds its interpreter (GIL)" in health(status, "greedy").reason
    manager.deploy()
    manager.wait_for(lambda s: not s.containers)  # nobody waits for it


def test_a_step_in_a_container_that_is_stopped_meanwhile_fails_at_once(
    manager: Manager,
) -> None:
    """It does not wait for the limit of the order, which is longer than the test's."""
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    os.kill(container.pid, signal.SIGSTOP)
    steps = MigrationSteps(9, 1, "quiet", (Step("redirect", "x"),), limit=1e3)
    failed = manager.ask(steps)
    assert isinstance(failed, StepsFailed)
    assert "does not respond" in failed.reason
    os.kill(container.pid, signal.SIGKILL)


def test_a_step_in_a_container_whose_interpreter_is_held_fails_at_once(
    manager: Manager,
) -> None:
    """It does not wait for the limit of the step, which is longer than the test's."""
    manager.deploy("greedy")
    manager.wait_for(lambda s: health(s, "greedy").state == "unresponsive")
    for number in (10, 11):
        steps = MigrationSteps(number, 1, "greedy", (Step("redirect", "x"),), limit=1e3)
        failed = manager.ask(steps)
        assert isinstance(failed, StepsFailed)
        assert "interpreter (GIL)" in failed.reason
    manager.deploy()
    manager.wait_for(lambda s: not s.containers)


def limit_descriptors(pid: int, more: int | None) -> None:
    """Let a process open only `more` descriptors besides those that it has."""
    used = {int(file.name) for file in _descriptors(pid)}
    _, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    free = (number for number in count() if number not in used)
    limit = hard if more is None else next(islice(free, more, None))
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (limit, hard))


@pytest.mark.parametrize("who", ["agent", "zygote"])
def test_lives_on_without_a_free_descriptor(doomed: Manager, who: str) -> None:
    agent = doomed.process.pid
    (zygote,) = children_of(agent)
    limit_descriptors(*((agent, 3) if who == "agent" else (zygote, 1)))
    doomed.deploy("quiet", "busy", "calm")
    status = doomed.wait_for(lambda status: len(doomed.faults(status)) >= 3)
    assert {"cannot be started" in f.message for f in doomed.faults()} == {True}
    known = [health(status, name) for name in ("quiet", "busy", "calm")]
    assert {h.reason.split(":")[0] for h in known} == {"cannot be started"}
    assert {h.restarts for h in known} == {0}  # none of them ever ran
    assert {h.state for h in known} == {"restarting"}
    for pid in (agent, zygote):
        limit_descriptors(pid, None)
    for name in ("quiet", "busy", "calm"):
        doomed.wait_active(name)


def test_a_slow_import_holds_up_nobody(manager: Manager) -> None:
    """The other component is active before the import that waits for it ends."""
    quiet, slow = "quiet_module:Quiet", "slow_module:Slow"
    (manager.folder / "slow_module.py").write_text(SLOW_MODULE)
    go_on = manager.folder / "go_on"
    components = tuple(
        ComponentSpec(name=name, goal="active", implementation=reference)
        for name, reference in (("slow", slow), ("quiet", quiet))
    )
    manager.deploy_container("both", *components)
    status = manager.wait_for(lambda s: states(s).get("quiet") == "active")
    assert states(status)["slow"] == "unconfigured"
    go_on.touch()
    manager.wait_for(lambda s: states(s).get("slow") == "active")


@pytest.mark.parametrize(
    ("protocol", "older"),
    [(PROTOCOL + 2, "agent"), (LEAST_PROTOCOL - 1, "manager")],
)
def test_refuses_protocols_far_from_its_own_whatever_they_look_like(
    manager: Manager, protocol: int, older: str
) -> None:
    versions = {"protocol": protocol, "least": protocol - 1}
    foreign = {"type": "Deployment", **versions, "new": "field"}
    answer = manager.ask_raw(msgspec.msgpack.encode(foreign))
    assert isinstance(answer, Refused)
    said = f"manager speaks protocol {protocol - 1} to {protocol}, agent 'main' (Poise "
    assert answer.reason.startswith(said)
    spoken = f"speaks {LEAST_PROTOCOL} to {PROTOCOL}: upgrade the {older}"
    assert spoken in answer.reason


@pytest.mark.parametrize("protocol", [PROTOCOL + 1, PROTOCOL, LEAST_PROTOCOL])
def test_takes_requests_of_the_releases_before_and_after(
    manager: Manager, protocol: int
) -> None:
    request = ManagerRequest(token=9, request=ReadOutput())
    versions = {"protocol": protocol, "least": protocol - 1}
    said = msgspec.to_builtins(request) | versions | {"new": "field"}
    answer = manager.ask_raw(msgspec.msgpack.encode(said))
    assert isinstance(answer, Refused)
    assert "protocol" not in answer.reason  # but obeys another manager


def test_refuses_what_is_no_request(manager: Manager) -> None:
    answer = manager.ask_raw(b"\xc1nonsense")
    assert isinstance(answer, Refused)
    assert "not a request" in answer.reason


def test_refuses_a_manager_that_is_behind(manager: Manager) -> None:
    manager.deploy()
    manager.deploy()
    answer = manager.ask(Deployment(generation=1, containers=()))
    assert isinstance(answer, Refused)
    assert "generation 1 is older than" in answer.reason


def test_obeys_one_manager_until_that_is_gone(doomed: Manager) -> None:
    token = doomed._session.liveliness().declare_token("poise/test/manager/first")
    doomed.deploy("quiet")

    refused = doomed.ask(Claim(manager_id("second")), token=9)
    assert isinstance(refused, Refused)
    assert "robot 'test' is managed by user ann on desk (process 7)" in refused.reason
    doomed.wait_active("quiet")

    token.undeclare()  # type: ignore[no-untyped-call]
    assert isinstance(doomed.ask(Claim(manager_id("second")), token=1), Refused)
    wait_until(
        lambda: isinstance(doomed.ask(Claim(manager_id("second")), token=2), Claimed)
    )

    empty = Deployment(generation=99, containers=())
    assert isinstance(doomed.ask(empty, token=1), Refused)
    steps = MigrationSteps(7, 1, "quiet", (Step("redirect", "quiet"),), limit=1.0)
    refused = doomed.ask(steps, token=1)
    assert isinstance(refused, StepsFailed)
    assert "is managed by" in refused.reason
    doomed.wait_active("quiet")
    assert doomed.ask(empty, token=2) == Accepted()


def test_a_step_for_a_container_that_is_not_there_fails(manager: Manager) -> None:
    steps = MigrationSteps(7, 1, "ghost", (Step("redirect", "x"),), limit=1.0)
    assert manager.ask(steps) == StepsFailed(7, "container 'ghost' does not run")


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_ends_in_order_when_asked(doomed: Manager, sent: signal.Signals) -> None:
    doomed.deploy("quiet")
    container = doomed.wait_active("quiet")
    doomed.process.send_signal(sent)
    assert doomed.process.wait(LIMIT) == 0
    wait_gone(container.pid)
    assert not list(doomed.folder.glob("*.sock"))


def test_a_stopped_zygote_is_named_with_what_lets_it_go_on(manager: Manager) -> None:
    manager.deploy("quiet")
    before = manager.wait_active("quiet").pid
    (zygote,) = children_of(manager.process.pid)
    os.kill(zygote, signal.SIGSTOP)
    os.kill(before, signal.SIGKILL)
    status = manager.wait_for(lambda status: "is stopped" in status.trouble)
    assert f"`kill -CONT {zygote}` lets it go on" in status.trouble
    os.kill(zygote, signal.SIGCONT)
    manager.wait_active("quiet", but_not=before)
    status = manager.wait_for(lambda status: not status.trouble)
    messages = [fault.message for fault in manager.faults(status)]
    assert not any("GIL" in message for message in messages), messages


def test_without_its_zygote_what_runs_goes_on_and_the_status_says_so(
    doomed: Manager,
) -> None:
    doomed.deploy("quiet", "calm")
    pids = [doomed.wait_active(name).pid for name in ("quiet", "calm")]
    (zygote,) = children_of(doomed.process.pid)
    os.kill(zygote, signal.SIGKILL)
    status = doomed.wait_for(lambda status: "zygote is gone" in status.trouble)
    assert {each.pid for each in status.containers} == set(pids)
    os.kill(pids[1], signal.SIGKILL)  # its end is seen though it is nobody's child
    doomed.wait_for(lambda status: any(doomed.faults(status)))
    doomed.process.kill()
    doomed.process.wait()
    assert doomed.process.stderr
    doomed.process.stderr.close()  # the container has it, too: it does not end
    doomed.process = doomed.start_agent()
    assert doomed.wait_adopted("quiet").pid == pids[0]
    doomed.wait_active("calm", but_not=pids[1])


@pytest.mark.parametrize("data", [b"8 bytes.", b"", b"x" * 4000])
def test_what_is_no_container_at_its_socket_is_shown_and_stops_nothing(
    doomed: Manager, data: bytes
) -> None:
    doomed.deploy("quiet")
    pid = doomed.wait_active("quiet").pid
    out, into = os.pipe()
    pipe = str(Path(f"/proc/self/fd/{out}").readlink())
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.connect(os.fspath(agent_path(doomed.folder)))
        for _ in range(5):
            socket.send_fds(asking, [data], [out, into])
    if data:
        status = doomed.wait_for(lambda status: bool(status.errors))
        assert "not a container of this version" in status.errors[0].text
    os.close(out)
    os.close(into)
    doomed.deploy("quiet", "calm")
    doomed.wait_active("calm")
    assert doomed.wait_active("quiet").pid == pid
    wait_until(lambda: pipe not in _open_files(doomed.process.pid))


def test_an_error_of_its_loop_leaves_containers_and_what_should_run(
    doomed: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(doomed.folder))
    (doomed.folder / "sitecustomize.py").write_text(BROKEN_LOOP)
    doomed.process.kill()
    doomed.process.communicate()
    doomed.process = doomed.start_agent()
    doomed.wait_agent()
    doomed.ask(Claim(manager_id("second")), token=9)
    doomed.token = 9
    doomed.deploy("quiet")
    pid = doomed.wait_active("quiet").pid
    (doomed.folder / "break").touch()
    assert doomed.process.wait(LIMIT) == BROKEN
    assert doomed.process.stderr
    doomed.process.stderr.close()
    (doomed.folder / "break").unlink()
    doomed.process = doomed.start_agent()
    assert doomed.wait_adopted("quiet").pid == pid


def test_no_container_holds_anothers_end(manager: Manager) -> None:
    manager.deploy("quiet", "calm")
    pids = [manager.wait_active(name).pid for name in ("quiet", "calm")]
    held = [{str(fd.readlink()) for fd in _descriptors(pid)} for pid in pids]
    assert {
        connection
        for connection in held[0] & held[1]
        if connection.startswith("socket:")
    } == set()
    lifeline = Path(f"/proc/self/fd/{manager.lifeline}").readlink()
    assert str(lifeline) not in held[0] | held[1]


def _descriptors(pid: int) -> Iterator[Path]:
    return Path(f"/proc/{pid}/fd").iterdir()


def _open_files(pid: int) -> set[str]:
    """Return what a process has open; what it closes meanwhile is left out."""
    found = set()
    for file in _descriptors(pid):
        with contextlib.suppress(FileNotFoundError):
            found.add(str(file.readlink()))
    return found


def test_memory_runs_out_for_containers_first(manager: Manager) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    scores = [
        int(Path(f"/proc/{pid}/oom_score_adj").read_text())
        for pid in (container.pid, manager.process.pid)
    ]
    assert scores[0] == 500
    assert scores[1] < 500


def test_an_address_in_use_is_told(manager: Manager) -> None:
    second = manager.start_agent("--folder", str(manager.folder / "second"))
    _, said = second.communicate(timeout=LIMIT)
    assert second.returncode == 1
    assert "cannot listen on tcp/127.0.0.1:" in said
    assert "Address already in use" in said


def test_a_folder_too_deep_for_sockets_is_told(manager: Manager) -> None:
    deep = manager.start_agent("--folder", "/tmp/" + "x" * 100)
    _, said = deep.communicate(timeout=LIMIT)
    assert deep.returncode == 2
    assert "bytes long, but sockets in a folder need one of at most" in said
