"""The zygote: a process that has imported everything and forks containers from itself.

A fork costs milliseconds and a few MB, a fresh interpreter 40 to 100 ms and its own
copy of everything. It is forked from the agent before that opens anything, and has one
thread, so that what it forks starts clean. When its agent was killed it stays until the
last container has ended, and kills those that do not end though no agent comes.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from msgspec import Struct

from poise import threads
from poise.errors import RunError, Unavailable
from poise.priority import be_nice
from poise.runtime.container.account import Account
from poise.runtime.container.agent_link import (
    ORPHAN_LIMIT,
    hand_over,
    is_adopting,
    take_over,
)
from poise.runtime.container.container import Container
from poise.runtime.hosting.descendants import (
    adopt_orphans,
    children,
    end_children,
    gain_no_rights,
    kill_all,
)
from poise.runtime.hosting.output import keep_output
from poise.waker import Waker, wait_readable
from poise.wire import frame
from poise.wire.connections.opening import own_keys

log = logging.getLogger(__name__)

PATIENCE = 2.0
"""Containers end within this time after they should have by themselves [s]."""
_LARGEST = 1 << 16
_LOOK_EVERY = 10.0
"""Without its agent it looks this often [s] whether there is another one."""
_KILL_LIMIT = 1.0
_LOOK_AT_ENDED = os.WEXITED | os.WNOHANG | os.WNOWAIT


class Fork(Struct, frozen=True, kw_only=True):
    """The agent asks for a container; control socket and stats page come with it."""

    name: str
    computer: str
    folder: str
    nice: int


class Forked(Struct, frozen=True, tag=True):
    """A container's process began."""

    name: str
    pid: int


class NotForked(Struct, frozen=True, tag=True):
    """A container's process could not begin."""

    name: str
    reason: str


class ContainerEnded(Struct, frozen=True, tag=True):
    """A container's process ended; `status` as ``waitpid`` gives it."""

    pid: int
    status: int


Event = Forked | NotForked | ContainerEnded


def start(
    closing: Sequence[int] = (), account: Account | None = None
) -> tuple[socket.socket, int]:
    """Fork the zygote, for an account; return its socket and process id."""
    # one record is one packet, so neither end ever waits for the rest of one
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    # the zygote has nothing else to do than to wait for the agent
    ours.settimeout(frame.RECORD_LIMIT)
    try:
        pid = os.fork()
    except OSError as error:
        ours.close()
        theirs.close()
        raise RunError(
            f"no container can be started ({error.strerror}): raise "
            f"{threads.PROCESS_LIMIT}"
        ) from error
    if pid == 0:
        ours.close()
        for fd in closing:
            os.close(fd)
        _leave(lambda: _Zygote(theirs).serve(account))
    theirs.close()
    return ours, pid


def absent() -> tuple[socket.socket, int]:
    """Return what `start` does, of a zygote that was never forked."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.close()
    return ours, 0


def ask(zygote: socket.socket, wanted: Fork, stats_page: int) -> socket.socket:
    """Ask for a container that counts in `stats_page`; return its control socket."""
    try:
        return hand_over(zygote, wanted, stats_page)
    except ConnectionError as error:
        raise Unavailable(f"the zygote is gone: {error}") from error


def hear(zygote: socket.socket) -> Event:
    """Return what the zygote says next."""
    try:
        body = zygote.recv(_LARGEST)
    except OSError as error:
        raise Unavailable(f"the zygote is gone: {error}") from error
    if not body:
        raise Unavailable("the zygote is gone")
    event: Event = frame.unpack_record(body, Event)
    return event


def end(zygote: socket.socket, pid: int) -> None:
    """Let the zygote end, whose containers have ended."""
    zygote.close()
    if not pid:
        return
    pidfd = os.pidfd_open(pid)
    try:
        if not wait_readable([pidfd], PATIENCE + 1):
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    finally:
        os.close(pidfd)


def _leave(work: Callable[[], None]) -> None:
    """Run `work` in a forked process, which ends with it, whatever happens."""
    code = 1
    try:
        work()
        code = 0
    except RunError as error:  # says all: what a component did, not Poise
        log.error("process %d ends: %s", os.getpid(), error)  # noqa: TRY400
    except BaseException:
        # nobody is above it: what is not logged here is lost
        log.exception("process %d ends", os.getpid())
    finally:
        for stream_ in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream_.flush()
        os._exit(code)


def _show_as(name: str) -> None:
    """Let `top` and `ps -o comm` show this process by a name; of 15 bytes at most."""
    Path("/proc/self/comm").write_text(name)


class _Zygote:
    """The process itself."""

    def __init__(self, agent: socket.socket) -> None:
        self._agent = agent
        self._waker = Waker()
        self._containers: set[int] = set()
        self._folder = Path()

    def serve(self, account: Account | None) -> None:
        """Fork what the agent asks for, until it and all containers are gone."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _show_as("poise-zygote")
        adopt_orphans()
        gain_no_rights()
        if account is not None:
            own_keys()  # containers cannot read them
            account.become()
        # Blocked, not ignored: only the agent's end ends the zygote, and a container
        # must not lose one that comes before it has its handler.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        signal.set_wakeup_fd(self._waker.signal_fd)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        try:
            while True:
                self._serve_one()
        except (Unavailable, ConnectionError):
            pass
        finally:
            self._outlive_agent()
            end_children(_KILL_LIMIT)

    def _serve_one(self) -> None:
        ready = wait_readable([self._agent.fileno(), self._waker.fileno()], None)
        if self._waker.fileno() in ready:
            self._waker.clear()
            for pid, status in self._ended():
                self._tell(ContainerEnded(pid, status))
        if self._agent.fileno() in ready:
            self._fork_next()

    def _tell(self, event: Event) -> None:
        self._agent.send(frame.pack_record(event))

    def _ended(self) -> list[tuple[int, int]]:
        """Return the containers that ended since the last poll; kill what they left."""
        ended = []
        with contextlib.suppress(ChildProcessError):
            while info := os.waitid(os.P_ALL, 0, _LOOK_AT_ENDED):
                # before it is reaped no other process has its number
                kill_all({info.si_pid} & self._containers)
                end = os.waitpid(info.si_pid, 0)
                if info.si_pid in self._containers:
                    self._containers.remove(info.si_pid)
                    ended.append(end)
        kill_all(children() - self._containers)
        return ended

    def _fork_next(self) -> None:
        wanted, connection, stats_page = take_over(self._agent, Fork)
        self._folder = Path(wanted.folder)
        if connection is None:
            why = "cannot be started: no descriptor is free"
            self._tell(NotForked(wanted.name, why))
            return
        with connection, contextlib.ExitStack() as closing:
            closing.callback(os.close, stats_page)
            try:
                pid = os.fork()
            except OSError as error:
                self._tell(NotForked(wanted.name, threads.without_process(error)))
                return
            if pid == 0:
                _leave(lambda: self._become(wanted, connection, stats_page))
        self._containers.add(pid)
        self._tell(Forked(wanted.name, pid))

    def _become(self, wanted: Fork, connection: socket.socket, stats_page: int) -> None:
        """Be a container from now on; keep nothing that is the zygote's."""
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.setsid()  # its process group can be killed
        _show_as(wanted.name)
        adopt_orphans()
        self._agent.close()
        self._waker.close()
        be_nice(wanted.nice)
        keep_output(self._folder, wanted.name)
        Container(
            wanted.name, wanted.computer, self._folder, connection, stats_page
        ).run()

    def _outlive_agent(self) -> None:
        """Reap the containers until there are none, or no agent comes for long."""
        self._agent.close()
        seen_at = time.monotonic()
        while self._containers:
            wait_readable([self._waker.fileno()], _LOOK_EVERY)
            self._waker.clear()
            self._ended()
            if is_adopting(self._folder):  # one that was just killed is replaced soon
                seen_at = time.monotonic()
            elif time.monotonic() - seen_at >= ORPHAN_LIMIT + PATIENCE:
                return
