"""Those who do not belong to a robot try to command its agents, and to be heard."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import msgspec
import pytest
import zenoh

from poise.clock import SystemClock
from poise.endpoint import Endpoint
from poise.kernel_counters import proportional_memory
from poise.manage.agent_connections.agents import Agents
from poise.manage.control_socket.agents_without_manager import NoManager, ask_agents
from poise.session.keys import Authority, init_keys
from poise.wire import refusal
from poise.wire.control_session import open_session
from poise.wire.credentials import Credentials
from poise.wire.heartbeats import UdpDatagrams
from poise.wire.records.heartbeat_records import Heartbeat
from poise.wire.refusal import why_all_refused
from poise.wire.robots_here import AgentAddresses
from tests.runtime.conftest import free_port
from tests.waiting import LIMIT, wait_until

pytestmark = pytest.mark.slow

ROBOT = "guarded"
SOON = 1.0
"""Whoever is let in has his answer long before [s]."""


class Guarded:
    """An agent with keys, and what it says."""

    def __init__(self, folder: Path, shell: str = "") -> None:
        self.folder = folder
        self.authority = init_keys(ROBOT, folder / "owner")
        self.owner = Credentials(self.authority.folder)
        self.port = free_port()
        self.log = folder / "log"
        keys = self.issue("left", "agent")
        argv = [sys.executable, "-m", "poise", "agent", "left", "--robot", ROBOT]
        argv += ["--address", "127.0.0.1", "--port", str(self.port)]
        argv += ["--keys", str(keys.folder), "--folder", str(folder / "agent")]
        argv = ["sh", "-c", f'{shell}\nexec "$@"', "sh", *argv]
        with self.log.open("w") as log:
            self.process = subprocess.Popen(argv, stdout=log, stderr=log)
        wait_until(lambda: "agent of computer 'left'" in self.said())

    def issue(self, name: str, role: str, by: Authority | None = None) -> Credentials:
        authority = by or self.authority
        folder = self.folder / f"{name}-{id(authority)}"
        return authority.issue(name, role, folder)  # type: ignore[arg-type]

    def said(self) -> str:
        return self.log.read_text()

    @property
    def endpoint(self) -> str:
        return f"tls/127.0.0.1:{self.port}"

    def answers(self, keys: Credentials | None, endpoint: str = "") -> bool:
        """Return whether the agent answers a request of who has these keys."""
        with open_session(connect=[endpoint or self.endpoint], keys=keys) as session:
            deadline = time.monotonic() + SOON
            while time.monotonic() < deadline:
                if [*session.get(f"poise/{ROBOT}/agent/left", timeout=SOON)]:
                    return True
                time.sleep(0.05)
        return False

    def end(self) -> None:
        self.process.terminate()
        assert self.process.wait(LIMIT) == 0


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    agent = Guarded(tmp_path_factory.mktemp("guarded"))
    yield agent
    agent.end()


def test_who_has_the_keys_is_answered(guarded: Guarded) -> None:
    assert guarded.answers(guarded.owner)
    ends = {"left": guarded.endpoint}
    with Agents(ROBOT, ends, SystemClock(), keys=guarded.owner) as agents:
        agents.wait_alive(ends, LIMIT)
        agents.claim({"left"})
        assert agents.obey("left")


def test_who_has_no_keys_is_refused_and_the_agent_says_so(guarded: Guarded) -> None:
    """As somebody did who ran ``id`` as the agent's user."""
    assert not guarded.answers(None, f"tcp/127.0.0.1:{guarded.port}")
    wait_until(lambda: "InvalidContentType" in guarded.said())


def test_keys_of_another_authority_are_refused(guarded: Guarded) -> None:
    """Of a robot with the same name."""
    forged = init_keys(ROBOT, guarded.folder / "forger")
    assert not guarded.answers(guarded.issue("kim", "manager", forged))
    wait_until(lambda: "UnknownCA" in guarded.said())


def test_keys_that_have_ended_are_refused(guarded: Guarded) -> None:
    folder = guarded.folder / "late"
    late = guarded.authority.issue("late", "manager", folder, days=-0.01)
    assert not guarded.answers(late)


def test_another_computer_may_not_command(guarded: Guarded) -> None:
    assert not guarded.answers(guarded.issue("right", "agent"))


def test_who_may_look_sees_its_news_and_may_not_command(guarded: Guarded) -> None:
    viewer = guarded.issue("eve", "viewer")
    assert not guarded.answers(viewer)
    seen: list[zenoh.Sample] = []
    with open_session(connect=[guarded.endpoint], keys=viewer) as session:
        subscriber = session.declare_subscriber(f"poise/{ROBOT}/status/*", seen.append)
        wait_until(lambda: seen)
        del subscriber


def test_who_may_look_is_no_manager(guarded: Guarded) -> None:
    """A liveliness token of his would let the agent wait for him."""
    viewer = guarded.issue("eve", "viewer")
    there: list[zenoh.Sample] = []
    with (
        open_session(connect=[guarded.endpoint], keys=guarded.owner) as owner,
        open_session(connect=[guarded.endpoint], keys=viewer) as session,
    ):
        token = session.liveliness().declare_token(f"poise/{ROBOT}/manager/forged")
        watching = owner.liveliness().declare_subscriber(
            f"poise/{ROBOT}/manager/*", there.append, history=True
        )
        time.sleep(SOON)
        del token, watching
    assert not there


def test_an_older_tls_is_refused(guarded: Guarded) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    files = guarded.owner.folder
    context.load_cert_chain(files / "certificate.pem", files / "key.pem")
    with (
        socket.create_connection(("127.0.0.1", guarded.port), LIMIT) as plain,
        pytest.raises((ssl.SSLError, ConnectionResetError)),
    ):
        context.wrap_socket(plain)


def _beat(sender: str) -> Heartbeat:
    return Heartbeat(
        robot=ROBOT, sender=sender, key="forged", number=1, sent=0.0, heard={}
    )


def test_forged_heartbeats_are_ignored_and_the_agent_says_so(guarded: Guarded) -> None:
    before = guarded.said()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as forger:
        data = msgspec.msgpack.encode(_beat("right"))
        forger.sendto(data, ("127.0.0.1", guarded.port))
        said = "a heartbeat from 127.0.0.1 is not signed with this robot's keys"
        wait_until(lambda: said in guarded.said()[len(before) :])


def test_only_signed_heartbeats_are_received(guarded: Guarded) -> None:
    clock, where = SystemClock(), Endpoint("127.0.0.1", free_port())
    receiver = UdpDatagrams(clock, where, keys=guarded.owner)
    forger = UdpDatagrams(clock, keys=None)
    other = init_keys(ROBOT, guarded.folder / "other")
    stranger = UdpDatagrams(clock, keys=Credentials(other.folder))
    friend = UdpDatagrams(clock, keys=guarded.issue("right", "agent"))
    with contextlib.ExitStack() as closing:
        for datagrams in (receiver, forger, stranger, friend):
            closing.callback(datagrams.close)
        for name, sender in (("forger", forger), ("stranger", stranger)):
            sender.send(_beat(name), [(where.host, where.port)])
        assert receiver.receive(clock.now() + 0.2) == []
        friend.send(_beat("friend"), [(where.host, where.port)])
        (received,) = receiver.receive(clock.now() + LIMIT)
        assert received[0].sender == "friend"


def _connect(guarded: Guarded, silent: list[socket.socket]) -> None:
    with contextlib.suppress(OSError):
        silent.append(socket.create_connection(("127.0.0.1", guarded.port), LIMIT))


def test_connections_that_say_nothing_hold_up_nobody(guarded: Guarded) -> None:
    """Those that end so only delay who comes then: zenoh waits 0.1 s after each."""
    silent: list[socket.socket] = []
    threads = [
        threading.Thread(target=_connect, args=(guarded, silent)) for _ in range(100)
    ]
    with open_session(connect=[guarded.endpoint], keys=guarded.owner) as session:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(LIMIT)
        try:
            assert guarded.answers(guarded.owner)
        finally:
            for connection in silent:
                connection.close()
        assert [*session.get(f"poise/{ROBOT}/agent/left", timeout=SOON)]
    wait_until(lambda: guarded.answers(guarded.owner))


def test_more_silent_connections_than_descriptors_shut_nobody_out(
    tmp_path: Path,
) -> None:
    agent = Guarded(tmp_path, "ulimit -S -n 64")
    try:
        silent: list[socket.socket] = []
        for _ in range(60):
            _connect(agent, silent)
        for connection in silent:
            connection.close()
        wait_until(lambda: agent.answers(agent.owner))
    finally:
        agent.end()


def _times(session: zenoh.Session) -> list[float]:
    """Return how long requests take, one after the other [s]."""
    times = []
    for _ in range(100):
        began = time.monotonic()
        assert [*session.get(f"poise/{ROBOT}/agent/left", timeout=LIMIT)]
        times.append(time.monotonic() - began)
    return times


def _shake_hands(guarded: Guarded, ends: threading.Event, begun: list[None]) -> None:
    """Begin TLS without keys, again and again."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    while not ends.is_set():
        with (
            contextlib.suppress(OSError),
            socket.create_connection(("127.0.0.1", guarded.port), SOON) as plain,
        ):
            begun.append(None)
            with context.wrap_socket(plain) as secured:
                secured.recv(1)


def test_a_flood_of_handshakes_neither_delays_nor_swells_an_agent(
    guarded: Guarded,
) -> None:
    ends, begun = threading.Event(), list[None]()
    crowd = [
        threading.Thread(target=_shake_hands, args=(guarded, ends, begun))
        for _ in range(20)
    ]
    with open_session(connect=[guarded.endpoint], keys=guarded.owner) as session:
        wait_until(lambda: [*session.get(f"poise/{ROBOT}/agent/left", timeout=SOON)])
        calm, before = _times(session), proportional_memory(guarded.process.pid)
        for thread in crowd:
            thread.start()
        try:
            wait_until(lambda: len(begun) >= 40)
            flooded = _times(session)
        finally:
            ends.set()
            for thread in crowd:
                thread.join(LIMIT)
        grown = proportional_memory(guarded.process.pid) - before
    assert median(flooded) < max(0.05, 10 * median(calm))
    assert grown < 32 << 20
    wait_until(lambda: guarded.answers(guarded.owner))


def _gateway(guarded: Guarded) -> tuple[str, int]:
    found = re.search(r"gateway ([\d.]+):(\d+)", guarded.said())
    assert found
    return found[1], int(found[2])


@pytest.mark.parametrize(
    "data",
    [
        b"\xff" * 8,  # a length of 4 GiB
        b"\x10\x00\x00\x00\x00\x00\x00\x00" + b"x" * 16,  # no frame
        b"\x16\x03\x01" + bytes(200),  # a broken handshake
        os.urandom(4096),
    ],
)
def test_nonsense_at_the_gateway_ends_only_itself(
    guarded: Guarded, data: bytes
) -> None:
    with socket.create_connection(_gateway(guarded), LIMIT) as sock:
        sock.settimeout(LIMIT)
        with contextlib.suppress(OSError):  # it may close before all is sent
            sock.sendall(data)
            sock.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionResetError):
            while sock.recv(4096):
                pass
    assert guarded.process.poll() is None
    assert guarded.answers(guarded.owner)


def test_an_agent_off_loopback_wants_keys(tmp_path: Path) -> None:
    argv = [sys.executable, "-m", "poise", "agent", "left", "--robot", ROBOT]
    env = {**os.environ, "XDG_DATA_HOME": str(tmp_path)}
    done = subprocess.run(
        [*argv, "--address", "10.0.0.1"],
        env=env,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 2
    assert "there are no keys for robot 'guarded'" in done.stderr
    assert "poise keys issue" in done.stderr


def why_refused(agent: Endpoint, keys: Credentials | None) -> str:
    return why_all_refused({"": agent}, keys)[""]


def test_who_is_refused_is_told_why(guarded: Guarded, tmp_path: Path) -> None:
    agent = Endpoint("127.0.0.1", guarded.port)
    assert not why_refused(agent, guarded.owner)
    assert "it wants keys of this robot" in why_refused(agent, None)
    forged = guarded.issue("kim", "manager", init_keys(ROBOT, tmp_path / "forger"))
    assert "its certificate is not of this robot" in why_refused(agent, forged)
    late = guarded.authority.issue("kim", "manager", tmp_path / "late", days=-0.01)
    assert "it refuses the keys in" in why_refused(agent, late)


def test_a_robot_whose_agents_refuse_is_not_said_to_have_ended(
    guarded: Guarded, tmp_path: Path
) -> None:
    """Commands said that it does not run when the keys of its computers had ended."""
    forged = guarded.issue("lee", "manager", init_keys(ROBOT, tmp_path / "forger"))
    ends = {"left": guarded.endpoint}
    with pytest.raises(NoManager, match="runs is not known") as caught:
        ask_agents(AgentAddresses(ROBOT, ends, str(forged.folder)))
    assert "left: its certificate is not of this robot" in str(caught.value)
    owner = AgentAddresses(ROBOT, ends, str(guarded.owner.folder))
    assert ask_agents(owner) is None  # it runs nothing


def test_of_a_listener_without_tls_this_is_said(guarded: Guarded) -> None:
    """An agent that was stopped was said to run with --insecure."""
    with socket.create_server(("127.0.0.1", 0)) as plain:
        agent = Endpoint("127.0.0.1", plain.getsockname()[1])
        assert "not answer in TLS: it hangs" in why_refused(agent, guarded.owner)
        assert "another program have its port" in why_refused(agent, None)


@pytest.mark.parametrize("hangs", [True, False])
def test_that_large_packets_do_not_get_through_is_said(
    guarded: Guarded, monkeypatch: pytest.MonkeyPatch, *, hangs: bool
) -> None:
    """A way with an MTU of 576, and without ICMP, was taken for an agent that hangs."""
    sizes = []

    def handshake(plain: socket.socket, _: object) -> str:
        sizes.append(plain.getsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG))
        if hangs or sizes[-1] > 536:
            raise TimeoutError
        return ""

    monkeypatch.setattr(refusal, "_of_keys", handshake)
    with socket.create_server(("127.0.0.1", 0)) as plain:
        agent = Endpoint("127.0.0.1", plain.getsockname()[1])
        why = why_refused(agent, guarded.owner)
    assert sizes[1] < 536 < sizes[0]
    assert ("hangs" in why, "small packets reach it" in why) == (hangs, not hangs)
