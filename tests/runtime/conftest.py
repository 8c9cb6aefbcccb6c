"""Components to run, and two containers' wiring in one process."""

from __future__ import annotations

import contextlib
import random
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import pytest
from msgspec import structs

from poise import Component
from poise.clock import Elapsed, SystemClock
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Wiring
from poise.wire.connections.connection_server import ConnectionServer
from poise.wire.connections.gateway import Gateway
from poise.wire.records.deployment_records import (
    ChainPart,
    ComponentSpec,
    ConnectorKind,
    ConnectorSpec,
)
from tests.waiting import LIMIT, wait_until

C = TypeVar("C", bound=Component)


def free_port() -> int:
    """Return a port that nobody has, and that the system gives nobody by itself.

    One of those might be another connection's before the test's process listens there.
    """
    while True:
        port = random.randrange(10_000, 32_000)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


class News:
    """Wakes a test when something changed."""

    def __init__(self) -> None:
        self._changed = threading.Condition()

    def tell(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def wait_for(self, what: Callable[[], Any]) -> None:
        with self._changed:
            assert self._changed.wait_for(what, LIMIT)


class Pair:
    """Components ``source`` and ``target``, in one container or in two.

    `clocks` is how far the one's computer's clock is ahead as the other one knows it.
    """

    def __init__(self, kind: ConnectorKind, folder: Path) -> None:
        self.kind = kind
        self.news = News()
        self.servers: dict[str, ConnectionServer] = {}
        self.clocks: dict[str, Elapsed] = {}
        self.runners: dict[tuple[str, int], Runner] = {}
        self._specs: tuple[ConnectorSpec, ...] = ()
        self._closing = ExitStack()
        self.folder = folder
        self._gateway = self._closing.enter_context(Gateway(folder, "127.0.0.1"))
        self.sides = {"target": self._side("target")}
        self.sides["source"] = (
            self.sides["target"] if kind == "direct" else self._side("source")
        )

    def close(self) -> None:
        """End the components, then what joins them."""
        self._closing.close()

    def run(self, name: str, implementation: type[C], *chains: ChainPart) -> C:
        """Start a component; return it when it is inactive."""
        spec = ComponentSpec(name=name, goal="inactive", chains=chains)
        runner = Runner(spec, implementation, SystemClock(), self.news.tell)
        self.runners[name, 0] = runner
        self._closing.callback(_end, runner)
        runner.start()
        runner.aim("inactive")
        assert runner.life_cycle.wait_state({"inactive", "failed"}, LIMIT) == "inactive"
        component = runner.component
        assert isinstance(component, implementation)
        return component

    def join(
        self, port: str, other: str = "", *, limit: float = LIMIT
    ) -> ConnectorSpec:
        """Join a port of ``source`` to one of ``target``."""
        self._specs += (self._spec("source", port, "target", other or port, limit),)
        return self._specs[-1]

    def let_chains_pass(
        self, *, carries: tuple[str, ...] = (), answers: tuple[str, ...] = ()
    ) -> None:
        """Let the data of chains go over the connectors that were joined so far."""
        self._specs = tuple(
            structs.replace(spec, carries=carries, answers=answers)
            for spec in self._specs
        )

    def join_back(
        self, port: str, other: str, *, limit: float = LIMIT
    ) -> ConnectorSpec:
        """Join a port of ``target`` to one of ``source``."""
        self._specs += (self._spec("target", port, "source", other, limit),)
        return self._specs[-1]

    def activate(self) -> None:
        """Open all connectors, wait until they are joined, and make both active."""
        for name, side in self.sides.items():
            here = {key: r for key, r in self.runners.items() if key[0] == name}
            all_here = self.runners if self.kind == "direct" else here
            assert side.apply(self._specs, all_here) == {}
        wait_until(
            lambda: all(e.ready for side in self.sides.values() for e in side.status())
        )
        for runner in self.runners.values():
            runner.aim("active")
            assert runner.life_cycle.wait_state({"active", "failed"}, LIMIT) == "active"

    def part(self) -> None:
        """Close all connectors; both components stay."""
        for name, side in self.sides.items():
            here = {key: r for key, r in self.runners.items() if key[0] == name}
            side.apply((), self.runners if self.kind == "direct" else here)

    def start_source_anew(self, implementation: type[C]) -> C:
        """End the source's container as if it was killed, and start another."""
        self.sides["source"].close()
        _end(self.runners.pop(("source", 0)))
        if self.kind != "direct":
            self.sides["source"] = self._side("source")
        component = self.run("source", implementation)
        self.activate()
        return component

    def start_targets_computer_anew(self, implementation: type[C]) -> C:
        """End the target's container and gateway, and start others: the port is new."""
        self.sides["target"].close()
        self.servers["target"].close()
        _end(self.runners.pop(("target", 0)))
        self._gateway.close()
        self._gateway = self._closing.enter_context(Gateway(self.folder, "127.0.0.1"))
        address = f"{self._gateway}/target"
        self._specs = tuple(structs.replace(s, address=address) for s in self._specs)
        self.sides["target"] = self._side("target")
        component = self.run("target", implementation)
        self.activate()
        return component

    def drops(self) -> int:
        """Return how many messages were lost, as the connectors count."""
        sides = {id(side): side for side in self.sides.values()}.values()
        return sum(end.drops for side in sides for end in side.status())

    def _spec(
        self, source: str, port: str, target: str, other: str, limit: float
    ) -> ConnectorSpec:
        return ConnectorSpec(
            name=f"{source}.{port}-{target}.{other}",
            kind=self.kind,
            source=source,
            source_port=port,
            source_computer=source,
            target=target,
            target_port=other,
            target_computer=target,
            address=f"{self._gateway}/{target}" if self.kind == "remote" else target,
            limit=limit,
        )

    def _side(self, name: str) -> Wiring:
        server = self.servers[name] = ConnectionServer(self.folder, name)
        wiring = Wiring(server, self.clocks.get)
        self._closing.callback(server.close)
        self._closing.callback(wiring.close)
        return wiring


def _end(runner: Runner) -> None:
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)


@pytest.fixture
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    with tempfile.TemporaryDirectory() as folder:  # pytest's are too long for sockets
        pair = Pair(request.param, Path(folder))
        yield pair
        pair.close()


every_kind = pytest.mark.parametrize(
    "pair", ["direct", "local", "remote"], indirect=True
)
