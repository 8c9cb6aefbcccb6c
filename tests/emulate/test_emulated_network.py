"""Networks of namespaces."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from poise.emulate import Emulation, emulated_network
from poise.emulate import emulated_network as network_plan
from poise.emulate.emulated_network import Shape, plan_network
from poise.emulate.processes import Owner
from poise.errors import RobotError, RunError
from poise.model.robot import Link, Robot

OWNER = Owner(4242, 7)
LIMIT = 60.0
LINKS = (
    Link(between=("a", "b"), bandwidth=1e6, latency=0.002),
    Link(between=("b", "c"), bandwidth=5e6, latency=0.001),
)


def test_links_join_computers_by_their_numbers() -> None:
    plan = plan_network(OWNER, 0, ["a", "b", "c", "d"], LINKS)
    assert plan.links == (
        (0, 1, Shape(bandwidth=1e6, latency=0.002)),
        (1, 2, Shape(bandwidth=5e6, latency=0.001)),
    )


def test_a_tool_that_hangs_is_an_error_like_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def hang(*_: object, **__: object) -> None:
        raise subprocess.TimeoutExpired("ip", 10.0)

    monkeypatch.setattr(subprocess, "run", hang)
    plan = plan_network(OWNER, 0, ["a", "b"], ())
    with pytest.raises(RunError, match=r"ip took over 10 s: netns add poise-4242-7-0"):
        emulated_network.build(plan)


def test_addresses_differ_and_names_say_whose_they_are() -> None:
    plan = plan_network(OWNER, 3, ["a", "b"], ())
    addresses = [plan.owner_address, *(cable.address for cable in plan.cables)]
    assert len(set(addresses)) == 3
    assert len({address.rpartition(".")[0] for address in addresses}) == 1
    assert plan.namespaces == (
        "poise-4242-7-3-switch",
        "poise-4242-7-3-0",
        "poise-4242-7-3-1",
    )
    # The kernel takes names of up to 15 letters.
    widest = plan_network(Owner(4194304, 7), 1234, ["a"], ())
    assert len(widest.owner) <= 15


def test_each_link_is_shaped_at_both_ends_by_its_destination() -> None:
    plan = plan_network(OWNER, 0, ["a", "b", "c", "d"], LINKS)
    a, b, c, _ = plan.cables
    narrow = "rate 8000000bit burst 16384 cburst 16384 quantum 1514"
    wide = "rate 40000000bit burst 16384 cburst 16384 quantum 1514"
    root = "qdisc add dev eth0 root handle 1: htb"
    new_class = "class replace dev eth0 parent 1: classid"
    new_filter = "filter add dev eth0 parent 1: protocol ip prio 1 u32 match ip dst"
    to_a = [
        f"{new_class} 1:1 htb {narrow}",
        "qdisc replace dev eth0 parent 1:1 bfifo limit 56384",
        f"{new_filter} {a.address}/32 flowid 1:1",
    ]
    to_b = [
        "qdisc replace dev eth0 parent 1:2 bfifo limit 56384",
        f"{new_filter} {b.address}/32 flowid 1:2",
    ]
    to_c = [
        f"{new_class} 1:3 htb {wide}",
        "qdisc replace dev eth0 parent 1:3 bfifo limit 216384",
        f"{new_filter} {c.address}/32 flowid 1:3",
    ]
    shaping = dict(emulated_network.shaping(plan, delays=False))
    assert shaping[a.namespace] == [root, f"{new_class} 1:2 htb {narrow}", *to_b]
    assert shaping[b.namespace] == [root, *to_a, *to_c]
    assert shaping.keys() == {a.namespace, b.namespace, c.namespace}


@pytest.mark.parametrize(
    ("bandwidth", "rate"), [(0.01, "8bit"), (1e12, "100000000000bit")]
)
def test_links_are_as_slow_and_as_quick_as_they_can_be(
    bandwidth: float, rate: str
) -> None:
    links = (Link(between=("a", "b"), bandwidth=bandwidth),)
    plan = plan_network(OWNER, 0, ["a", "b"], links)
    commands = network_plan.shaping(plan, delays=False)[0][1]
    assert any(f"htb rate {rate} " in command for command in commands)


def test_what_waits_for_the_delay_is_not_dropped() -> None:
    plan = plan_network(OWNER, 0, ["a", "b"], LINKS)
    _, commands = emulated_network.shaping(plan, delays=True)[0]
    # 1 MB/s for 40 ms in the queue, and for 2 ms under way, and a bucket of 16 KiB
    queue = "netem delay 2000us limit 38"
    assert f"qdisc replace dev eth0 parent 1:2 {queue}" in commands


def test_too_many_computers_are_refused() -> None:
    with pytest.raises(RobotError, match=r"254 computers .* at most 253"):
        plan_network(OWNER, 0, [str(number) for number in range(254)], ())


SEND = (
    "import socket, sys\n"
    "with socket.create_connection((sys.argv[1], int(sys.argv[2])), 60) as s:\n"
    "    s.sendall(bytes(3_000_000))\n"
)
SERVE = (
    "import socket, sys, time\n"
    "with socket.create_server((sys.argv[1], 0)) as server:\n"
    "    # what waits to be received must not count as quick\n"
    "    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)\n"
    "    print(server.getsockname()[1], flush=True)\n"
    "    s, _ = server.accept()\n"
    "    got, start = len(s.recv(1 << 16)), time.monotonic()\n"
    "    while data := s.recv(1 << 16):\n"
    "        got += len(data)\n"
    "    print(got / (time.monotonic() - start))\n"
)


@pytest.mark.slow
@pytest.mark.usefixtures("needs_namespaces")
def test_link_carries_what_the_robot_file_says(
    two_computers: Robot, tmp_path: Path
) -> None:
    with Emulation(two_computers, tmp_path) as emulation:
        brain, legs = emulation.computers.values()
        server = brain.popen(
            [sys.executable, "-c", SERVE, brain.address], stdout=subprocess.PIPE
        )
        assert server.stdout
        port = server.stdout.readline().decode().strip()
        client = legs.popen([sys.executable, "-c", SEND, brain.address, port])
        assert client.wait(timeout=LIMIT) == 0
        rate = float(server.stdout.readline())
        argv = ["ip", "-json", "-statistics", "link", "show", "eth0"]
        output, _ = brain.popen(argv, stdout=subprocess.PIPE).communicate(timeout=LIMIT)
        (link,) = json.loads(output)
        server.stdout.close()
    # 100 Mbit/s is 12.5 MB/s; unshaped, it would be some 1000 MB/s. A busy machine may
    # send less.
    assert 0.2 * 12.5e6 < rate < 1.1 * 12.5e6
    # Packets are of the size that a real link carries, not joined to 64 KB.
    received = link["stats64"]["rx"]
    assert received["bytes"] / received["packets"] < 1600


@pytest.mark.slow
@pytest.mark.usefixtures("needs_namespaces")
def test_owner_reaches_the_computers(two_computers: Robot, tmp_path: Path) -> None:
    with Emulation(two_computers, tmp_path) as emulation:
        brain = emulation.computers["brain"]
        server = brain.popen(
            [sys.executable, "-c", SERVE, brain.address], stdout=subprocess.PIPE
        )
        assert server.stdout
        port = int(server.stdout.readline())
        with socket.create_connection((brain.address, port), LIMIT) as connection:
            assert connection.getsockname()[0] == emulation.address
        server.stdout.close()


@pytest.mark.slow
@pytest.mark.usefixtures("needs_namespaces")
def test_socket_by_path_is_reached_from_another_computer(
    two_computers: Robot, tmp_path: Path
) -> None:
    with (
        socket.socket(socket.AF_UNIX) as server,
        Emulation(two_computers, tmp_path / "run") as emulation,
    ):
        server.bind(str(tmp_path / "device"))
        server.listen()
        server.settimeout(LIMIT)
        code = (
            "import socket, sys; s = socket.socket(socket.AF_UNIX);"
            "s.connect(sys.argv[1]); s.send(b'here')"
        )
        argv = [sys.executable, "-c", code, str(tmp_path / "device")]
        emulation.computers["legs"].popen(argv)
        connection, _ = server.accept()
        with connection:
            connection.settimeout(LIMIT)
            assert connection.recv(4) == b"here"


def test_free_subnet_is_not_one_that_is_in_use() -> None:
    start = time.monotonic_ns() % 65536
    first = network_plan._free_subnet(start)
    assert not any(first.overlaps(route) for route in network_plan._routes())
    assert first.prefixlen == 24
