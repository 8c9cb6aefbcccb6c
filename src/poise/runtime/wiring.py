"""Opens and closes the ends of connectors that lie in one container."""

from __future__ import annotations

import contextlib
import re
import traceback
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from functools import partial
from pathlib import Path as FilePath

import zenoh
from msgspec import Struct

from poise.clock import Elapsed
from poise.errors import RobotError, RunError, UsageError
from poise.runtime.connectors.counts import Counts
from poise.runtime.connectors.credits import GRANTS, Credit, Credits, Grants
from poise.runtime.connectors.direct import DirectPath
from poise.runtime.connectors.far_clock import FarClock, nobody_knows
from poise.runtime.connectors.outlet import Outlet, Path
from poise.runtime.connectors.wired import WiredPath, receiving
from poise.runtime.ports import Port
from poise.runtime.priority import first
from poise.runtime.runner import Runner
from poise.wire.codec import WireError
from poise.wire.local import LocalPipe, LocalServer
from poise.wire.messages import ConnectorKind, ConnectorSpec, ConnectorStatus, End
from poise.wire.pipe import Pipe, Server
from poise.wire.remote import RemotePipe, RemoteServer, keep_memory, open_session
from poise.wire.socket_path import socket_path

_ADDRESS = re.compile(r"[\w-]+(\.[\w-]+)*")
"""How a container may say where it is: a socket's name, or a zenoh id."""
_GRANT_LIMIT = 0.2

Runners = Mapping[tuple[str, int], Runner]
"""The incarnations of components in a container, by name and epoch."""


class Place(Struct, frozen=True, kw_only=True):
    """Where a container is.

    Parameters
    ----------
    prefix
        What all zenoh keys of the robot begin with.
    address
        IP address of its computer, on which it may listen.
    agents
        zenoh endpoints of all computers' agents, who know where containers are.
    socket
        Path of the AF_UNIX socket for containers of the same computer.
    computer
        The name of its computer.
    """

    prefix: str
    address: str
    agents: tuple[str, ...]
    socket: str
    computer: str = ""


class Transports:
    """The pipes and servers of a container; each kind is opened when first needed."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self._session: zenoh.Session | None = None
        self._local: LocalServer | None = None
        self._remote: RemoteServer | None = None
        self._credits = Credits()
        self._hears_grants: set[ConnectorKind] = set()

    def local_pipe(self, key: str, container: str) -> Pipe:
        """Return a pipe to another container of this computer."""
        path = socket_path(FilePath(self._place.socket).parent, container)
        return LocalPipe(key, str(path))

    def remote_pipe(self, key: str, limit: float, *, calls: bool = True) -> Pipe:
        """Return a pipe to a container of any computer."""
        full = f"{self._place.prefix}/pipe/{key}"
        return RemotePipe(self._zenoh(), full, limit, calls=calls)

    def local_server(self) -> Server:
        """Return where pipes from this computer end."""
        if self._local is None:
            self._local = LocalServer(FilePath(self._place.socket))
        return self._local

    def remote_server(self) -> Server:
        """Return where pipes from any computer end."""
        if self._remote is None:
            prefix = f"{self._place.prefix}/pipe"
            self._remote = RemoteServer(self._zenoh(), prefix)
        return self._remote

    def server(self, kind: ConnectorKind) -> Server:
        """Return where pipes of a kind end."""
        return self.local_server() if kind == "local" else self.remote_server()

    def credit(self, kind: ConnectorKind) -> Credit:
        """Return the credit of a new path; its grants are heard from now on."""
        if kind not in self._hears_grants:
            self._hears_grants.add(kind)
            key = GRANTS if kind == "local" else f"{GRANTS}/{self._address(kind)}"
            self.server(kind).open(key, self._credits.handle, calls=False)
        return self._credits.open(self._address(kind))

    def grant_pipe(self, kind: ConnectorKind, address: str) -> Pipe:
        """Return a pipe to where a container hears its grants.

        Raises
        ------
        WireError
            `address` is none.
        """
        if not _ADDRESS.fullmatch(address):
            raise WireError(f"'{address}' is no address of a container")
        if kind == "local":
            path = FilePath(self._place.socket).with_name(address)
            return LocalPipe(GRANTS, str(path))
        return self.remote_pipe(f"{GRANTS}/{address}", _GRANT_LIMIT, calls=False)

    def close(self) -> None:
        """Close all that was opened."""
        for server in (self._local, self._remote):
            if server is not None:
                server.close()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def _address(self, kind: ConnectorKind) -> str:
        if kind == "local":
            return FilePath(self._place.socket).name
        return str(self._zenoh().zid())

    def _zenoh(self) -> zenoh.Session:
        if self._session is None:
            keep_memory()
            with first():  # zenoh's threads only carry
                self._session = open_session(
                    listen=[f"tcp/{self._place.address}:0"], connect=self._place.agents
                )
        return self._session


class OpenEnds:
    """What one connector has open in this container.

    `path` and `outlet` are there when the source's end is.
    """

    def __init__(self, spec: ConnectorSpec) -> None:
        self.spec = spec
        self.closing = ExitStack()
        self.path: Path | None = None
        self.outlet: Outlet | None = None
        self.counts: Counts = Counts()
        self.far = FarClock()

    def is_ready(self) -> bool:
        """Return whether the other end is there, so far as this one can know."""
        return self.path is None or self.path.is_ready()

    def status(self) -> ConnectorStatus:
        """Return what was counted, and whether the other end is there."""
        self.far.look()
        end: End = "target" if self.outlet is None else "source"
        if self.spec.kind == "direct":
            end = "both"
        return self.counts.status(
            self.spec.name, self.spec.kind, end, ready=self.is_ready()
        )


class Wiring:
    """The connectors of a container.

    Parameters
    ----------
    ahead
        Returns how far another computer's clock is ahead, if that is known.
    """

    def __init__(
        self,
        transports: Transports,
        ahead: Callable[[str], Elapsed | None] = nobody_knows,
    ) -> None:
        self._transports = transports
        self._ahead = ahead
        self._open: dict[str, OpenEnds] = {}

    def apply(
        self, specs: tuple[ConnectorSpec, ...], runners: Runners
    ) -> dict[tuple[str, int], str]:
        """Make the open connectors those of `specs`, touching only what changed.

        Paths are opened before others are closed, so that a source that has both
        goes over from one to the other.

        Returns
        -------
        Incarnation -> why a connector at one of its ports cannot be opened.
        """
        wanted = {spec.key: spec for spec in specs}
        known = {ends.outlet for ends in self._open.values()}
        troubles: dict[tuple[str, int], str] = {}
        for key, spec in wanted.items():
            here = _ends_here(spec, runners)
            # without one of a direct connector's ends, the other has nothing to join
            if key in self._open or len(here) < (2 if spec.kind == "direct" else 1):
                continue
            try:
                self._open[key] = self._join(spec, runners)
            except Exception:  # noqa: BLE001, reading types runs users' code
                text = f"connector {spec.name}:\n{traceback.format_exc()}"
                troubles.update(dict.fromkeys(here, text))
        self._hold_amid_a_move(known)
        for key in list(self._open):
            if key not in wanted:
                self._open.pop(key).closing.close()
        return troubles

    def outlet(self, name: str) -> Outlet:
        """Return the source's end of a connector that is open here.

        Raises
        ------
        UsageError
            There is none.
        """
        for ends in self._open.values():
            if ends.spec.name == name and ends.outlet is not None:
                return ends.outlet
        raise UsageError(f"no connector '{name}' begins in this container")

    def outlet_to(self, key: str) -> Outlet:
        """Return the source's end of the open connector with this key.

        Raises
        ------
        UsageError
            There is none.
        """
        ends = self._open.get(key)
        if ends is None or ends.outlet is None:
            raise UsageError(f"no connector with key '{key}' begins in this container")
        return ends.outlet

    def unjoined(self) -> frozenset[str]:
        """Return the keys of the connectors whose other end is not there."""
        return frozenset(
            key for key, ends in list(self._open.items()) if not ends.is_ready()
        )

    def status(self) -> tuple[ConnectorStatus, ...]:
        """Return the status of every open connector."""
        return tuple(ends.status() for ends in list(self._open.values()))

    def ends(self) -> list[OpenEnds]:
        """Return what is open now, for those who count."""
        return list(self._open.values())

    def close(self) -> None:
        """Close every connector."""
        for ends in self._open.values():
            ends.closing.close()
        self._open.clear()

    def _hold_amid_a_move(self, known: AbstractSet[Outlet | None]) -> None:
        """Let what begins while its target moves send nothing before that is over.

        The container was started anew, and its first incarnation was told to hold.
        """
        for ends in self._open.values():
            outlet = ends.outlet
            if outlet is not None and outlet not in known:
                with contextlib.suppress(RunError):  # its target does not move
                    outlet.hold()

    def _join(self, spec: ConnectorSpec, runners: Runners) -> OpenEnds:
        ends = OpenEnds(spec)
        source = runners.get((spec.source, spec.source_epoch))
        target = runners.get((spec.target, spec.target_epoch))
        if spec.kind == "remote":
            far = spec.source_computer if source is None else spec.target_computer
            ends.far = FarClock(partial(self._ahead, far))
        with ExitStack() as undo:
            undo.callback(ends.closing.close)
            if source is not None:
                self._open_source(ends, source, target)
            elif target is not None:
                self._open_target(ends, target)
            undo.pop_all()
        return ends

    def _open_source(
        self, ends: OpenEnds, source: Runner, target: Runner | None
    ) -> None:
        spec = ends.spec
        port = _port(source, spec.source_port)
        outlet = source.ends.outlet(spec.slot or spec.name, port, spec.limit)
        if target is not None:
            far = _port(target, spec.target_port)
            ends.path = DirectPath(spec.name, target.ends, far, spec.limit, outlet)
        else:
            credit = self._transports.credit(spec.kind)
            credit.on_grant = outlet.room
            pipe = self._pipe(spec, calls=port.kind == "requires")
            ends.path = WiredPath(pipe, port, spec.limit, credit, ends.far)
        ends.outlet = outlet
        ends.counts = outlet.counts
        outlet.add(spec.key, ends.path)
        ends.closing.callback(_remove_path, source, outlet, spec.key)

    def _open_target(self, ends: OpenEnds, target: Runner) -> None:
        spec = ends.spec
        port = _port(target, spec.target_port)
        feed = target.ends.feed(port.name, ends.counts)
        open_pipe = partial(self._transports.grant_pipe, spec.kind)
        grants = Grants(feed, ends.counts, open_pipe)
        ends.closing.callback(grants.close)
        handler = receiving(
            spec,
            target.ends,
            port,
            feed,
            grants,
            ends.far,
            # a socket that is not read would keep its publisher waiting
            at_once=spec.kind == "remote",
        )
        server = self._transports.server(spec.kind)
        calls = port.kind == "provides"
        server.open(spec.key, handler, ends.counts.refuse, feed.most, calls=calls)
        ends.closing.callback(server.shut, spec.key)

    def _pipe(self, spec: ConnectorSpec, *, calls: bool) -> Pipe:
        if spec.kind == "local":
            return self._transports.local_pipe(spec.key, spec.address)
        return self._transports.remote_pipe(spec.key, spec.limit, calls=calls)


def _ends_here(spec: ConnectorSpec, runners: Runners) -> list[tuple[str, int]]:
    ends = (spec.source, spec.source_epoch), (spec.target, spec.target_epoch)
    return [end for end in ends if end in runners]


def _remove_path(source: Runner, outlet: Outlet, key: str) -> None:
    outlet.remove(key)
    if not outlet.paths():
        source.ends.drop_outlet(outlet.name)


def _port(runner: Runner, name: str) -> Port:
    try:
        return runner.ports[name]
    except KeyError:
        known = ", ".join(runner.ports) or "none"
        raise RobotError(
            f"component '{runner.spec.name}' has no port '{name}' (it has {known})"
        ) from None
