"""The agent: on each computer, the program that runs its containers.

One thread owns its sockets, files and signals; `AgentCore` decides. Containers survive
its crash, and the next agent in the same folder adopts them.
"""

from __future__ import annotations

import contextlib
import logging
import os
import random
import resource
import signal
import time
import uuid
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import zenoh
from msgspec.msgpack import encode

from poise import threads
from poise.clock import SystemClock, time_asleep, wall_time
from poise.endpoint import Endpoint
from poise.errors import RunError, Unavailable, UsageError
from poise.kernel_counters import ComputerMemory, Processes, cores_of_computer
from poise.priority import before_components, go_first, goes_first
from poise.runtime.agent.agent_files import (
    AgentFolder,
    AgentNote,
    CheckpointFiles,
    DiskThread,
)
from poise.runtime.agent.code_folder import CodeFolder, this_platform
from poise.runtime.agent.command_relay import CommandRelay
from poise.runtime.agent.core import AgentCore
from poise.runtime.agent.inbox import AgentInbox
from poise.runtime.agent.service_notice import ServiceNotice
from poise.runtime.agent.standby_process import StandbyProcess
from poise.runtime.agent.surroundings import (
    AgentSetup,
    HeartbeatTransport,
    Surroundings,
)
from poise.runtime.container import zygote
from poise.runtime.container.component_import import CODE_FOLDER
from poise.runtime.hosting.descendants import kill_all
from poise.runtime.supervision.adopted_containers import AdoptedContainers
from poise.runtime.supervision.container_processes import ProcessEnd
from poise.runtime.supervision.health import Silence
from poise.runtime.supervision.process_host import ControlLink, ProcessHost
from poise.runtime.supervision.sampler import Sampler
from poise.runtime.supervision.supervisor import part_of
from poise.version import VERSION
from poise.waker import Waker, wait_readable
from poise.wire.address import KEYS, socket_path
from poise.wire.codec import WireError
from poise.wire.connections.gateway import Gateway
from poise.wire.control_session import identity_key, locator, open_session
from poise.wire.heartbeats import Hear, Heartbeats, NextBeat, UdpDatagrams
from poise.wire.records.request_records import PROTOCOL

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials

log = logging.getLogger(__name__)

LEAVE = signal.SIGUSR1
"""Ends an agent whose containers go on, for the next agent to adopt them."""
_ORPHANS = "requests for adoption"
_ENDING_EVERY = 0.1
"""While containers end, the agent looks this often [s]."""


class Agent:
    """Runs the containers of one computer."""

    def __init__(self, setup: AgentSetup, say: Callable[[str], object]) -> None:
        self._setup = setup
        self._say = say
        self._clock = SystemClock()
        self._is_asked_to_end = self._is_leaving = False
        self._service = ServiceNotice()
        # their sockets and files; those of another user have a folder apart
        self._containers = Path(setup.folder, "run" if setup.account else "")
        try:
            socket_path(self._containers, "")
            self._path = Path(setup.folder)
            self._path.mkdir(mode=0o700, parents=True, exist_ok=True)
        except ValueError as error:
            raise UsageError(f"folder of agent '{setup.computer}': {error}") from error
        except OSError as error:
            raise UsageError(
                f"agent '{setup.computer}' cannot use the folder {setup.folder}: "
                f"{error.strerror}; choose another one with --folder"
            ) from error
        self._folder = AgentFolder(self._path)
        self._left = self._folder.left()
        if setup.account is not None:
            os.umask(0o077)  # its containers pass through its folder
            setup.account.make_folder(self._containers)
        self._keys = _keys(setup)
        self._code = _code(setup)
        os.environ[CODE_FOLDER] = setup.code  # for its containers
        self._standby = StandbyProcess(setup.computer, self._path, self._keys)
        # before any thread, zenoh session or descriptor of the agent's own exists
        held = () if setup.lifeline is None else (setup.lifeline,)
        self._has_zygote = not setup.is_witness
        self._zygote, self._zygote_pid = (
            zygote.start(held, setup.account) if self._has_zygote else zygote.absent()
        )
        _allow_files()  # to this process; components keep what they may open
        self._adoption = AdoptedContainers(self._containers, self._clock, setup.account)
        self._host = ProcessHost(self._zygote, setup.computer, self._containers)
        self._waker = Waker()
        self._endpoint = Endpoint(setup.address, setup.port)
        self._locator = locator(self._endpoint, self._keys)
        self._tokens: list[zenoh.LivelinessToken] = []
        self._core: AgentCore
        self._inbox: AgentInbox

    def run(self) -> None:
        """Work until a signal or the end of the lifeline."""
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, LEAVE):
            if signal.getsignal(number) != signal.SIG_IGN:  # as under `nohup`
                signal.signal(number, self._on_signal)
        try:
            with before_components():  # zenoh's threads inherit that
                self._run_in_session()
        finally:
            if self._is_asked_to_end and not self._is_leaving:
                zygote.end(self._zygote, self._zygote_pid)
            else:  # it stays until the containers have ended
                self._zygote.close()

    def _run_in_session(self) -> None:
        setup = self._setup
        with (
            self._open_gateway() as gateway,
            open_session(
                listen=[self._locator],
                timeout=setup.session_timeout,
                keys=self._keys,
                serves=setup.robot,
            ) as session,
        ):
            self._say(
                f"{'witness' if setup.is_witness else 'agent'} of computer "
                f"'{setup.computer}' of robot '{setup.robot}' at "
                f"{self._endpoint}, gateway {gateway}; "
                f"Poise {VERSION}, protocol {PROTOCOL}"
            )
            if notice := self._notice():
                self._say(notice)
            disk = self._disk(session)
            try:
                self._work(session, gateway, disk)
            finally:
                disk.stop()

    def _work(self, session: zenoh.Session, gateway: Gateway, disk: DiskThread) -> None:
        setup, prefix = self._setup, f"poise/{self._setup.robot}"
        sampler = self._sampler(session)
        world = self._surroundings(session, gateway, sampler, disk)
        core = self._core = AgentCore(setup, world, self._left)
        self._inbox = AgentInbox(
            setup.computer, core.on_request, self._waker.wake, core.supervised
        )
        threads.hear_failures(self._note_thread)
        answers = session.declare_queryable(
            f"{prefix}/agent/{setup.computer}", self._inbox.hear
        )
        control = f"{prefix}/control/{setup.computer}"
        relay = CommandRelay(control, lambda: core.fence.manager)
        commands = session.declare_queryable(control, relay.hear)
        managers = session.liveliness().declare_subscriber(
            f"{prefix}/manager/*", self._note_liveliness, history=True
        )
        go_first()
        if not goes_first():
            self._say(
                "it cannot raise the priority of its heartbeats: beside busy programs "
                "this computer may be considered lost (systemd: LimitNICE=-10; a "
                "user's service also needs it in user@.service)"
            )
        with contextlib.ExitStack() as working:
            working.callback(answers.undeclare)
            working.callback(commands.undeclare)
            working.callback(managers.undeclare)
            working.callback(sampler.stop)
            working.callback(core.heartbeats.close)
            for thread in (sampler, disk):
                thread.start()
            self._service.start(self._clock.now())
            while not self._is_asked_to_end:
                self._inbox.work()
                core.tick()
                self._await_news(min(core.moment(), self._service.due))
                self._service.live(self._clock.now())
        self._service.end()
        if self._is_leaving:
            self._core.leave()
        else:
            self._end_all()
        for token in self._tokens:
            token.undeclare()  # type: ignore[no-untyped-call]

    def _surroundings(
        self,
        session: zenoh.Session,
        gateway: Gateway,
        sampler: Sampler,
        disk: DiskThread,
    ) -> Surroundings:
        statuses = session.declare_publisher(
            f"poise/{self._setup.robot}/status/{self._setup.computer}"
        )
        return Surroundings(
            clock=self._clock,
            wall=wall_time,
            asleep=time_asleep,
            random=random.Random(),  # noqa: S311, no secret
            say=self._say,
            publish=lambda status: statuses.put(encode(status)),
            appear=lambda: self._appear(session),
            wake=self._waker.wake,
            host=self._host,
            adoption=self._adoption,
            disk=disk,
            code=self._code,
            version=VERSION,
            platform=this_platform(),
            cores=cores_of_computer(),
            computer_memory=ComputerMemory().size(),
            standby=self._standby,
            heartbeats=self._heartbeats,
            usage=sampler.usage,
            cpu=time.process_time,
            gateway=str(gateway),
            trouble=lambda: gateway.warning.trouble() or self._zygote_trouble(),
            notice=self._notice,
            pid=os.getpid(),
            key=uuid.uuid4().hex,
        )

    def _notice(self) -> str:
        if self._keys is not None:
            return self._keys.warning() or self._standby.notice()
        may = "have its vote" if self._setup.is_witness else "run code here"
        return f"without keys: whoever reaches {self._endpoint} can {may}"

    def _zygote_trouble(self) -> str:
        pid = self._zygote_pid
        if not Processes().is_stopped(pid):
            return ""
        return (
            "the zygote is stopped (SIGSTOP): no container starts, or is seen to end; "
            f"`kill -CONT {pid}` lets it go on"
        )

    def _open_gateway(self) -> Gateway:
        """Open it where the agent before had it, so that connectors find it again."""
        setup, left = self._setup, self._left.gateway
        before = Endpoint.parse(left).port if left else 0
        if before and not setup.gateway:
            with contextlib.suppress(RunError):  # the port is another's now
                return Gateway(self._containers, setup.address, before)
        return Gateway(self._containers, setup.address, setup.gateway)

    def _heartbeats(self, hear: Hear, next_beat: NextBeat) -> HeartbeatTransport | None:
        listen = self._endpoint
        try:
            datagrams = UdpDatagrams(self._clock, listen, keys=self._keys)
        except OSError as error:
            log.warning("no heartbeats: UDP port %d: %s", listen.port, error)
            return None
        return Heartbeats(self._clock, hear, next_beat, datagrams)

    def _sampler(self, session: zenoh.Session) -> Sampler:
        def on_silence(silence: Silence) -> None:
            self._inbox.put(partial(self._core.on_silence, silence))

        setup = self._setup
        samples = session.declare_publisher(
            f"poise/{setup.robot}/samples/{setup.computer}"
        )
        every, pages = setup.sample_every, self._host.pages
        return Sampler(setup.computer, every, pages, samples.put, on_silence)

    def _disk(self, session: zenoh.Session) -> DiskThread:
        copies = session.declare_publisher(
            f"poise/{self._setup.robot}/checkpoint/{self._setup.computer}",
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.BACKGROUND,
        )
        checkpoints = CheckpointFiles(
            self._containers, lambda copy: copies.put(encode(copy)), self._setup.account
        )
        if self._left.wanted is None:
            checkpoints.clear()
        return DiskThread(self._folder, checkpoints, self._clock, self._note())

    def _note(self) -> AgentNote | None:
        """Return what lets commands here find the robot; None: its manager does."""
        if self._setup.lifeline is not None:
            return None
        leads = self._keys.to_lead if self._keys is not None else None
        keys = str(leads) if leads is not None and leads.is_dir() else ""
        return AgentNote(self._setup.robot, keys)

    def _appear(self, session: zenoh.Session) -> None:
        robot, computer = self._setup.robot, self._setup.computer
        identity = identity_key(self._locator, robot, computer)
        for key in (f"poise/{robot}/alive/{computer}", identity)[len(self._tokens) :]:
            self._tokens.append(session.liveliness().declare_token(key))

    def _note_liveliness(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).rpartition("/")[2]
        is_there = sample.kind == zenoh.SampleKind.PUT
        self._core.heartbeats.note_liveliness(key, is_there=is_there)

    def _note_thread(self, name: str, error: BaseException) -> None:
        self._core.supervised.report(f"thread '{name}'", error)
        self._core.wake()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self._is_asked_to_end, self._is_leaving = True, number == LEAVE
        self._waker.wake()

    def _await_news(self, until: float) -> None:
        """Wait for news until some moment [s], and tell the core of it."""
        supervised, lifeline = self._core.supervised, self._setup.lifeline
        is_heard = self._core.supervisor.is_heard
        links = {x.fileno(): x for x in self._host.links() if is_heard(x.name)}
        pidfds, asking = self._adoption.pidfds(), self._adoption.fileno()
        waits_for = {
            self._waker.fileno(): True,
            self._zygote.fileno(): self._has_zygote,
            asking: asking >= 0 and not supervised.is_resting(_ORPHANS),
            lifeline: lifeline is not None and not self._is_asked_to_end,
        }
        fds = [
            fd for fd, does_wait in waits_for.items() if fd is not None and does_wait
        ]
        ready = wait_readable(
            [*fds, *pidfds, *links],
            max(0.0, until - self._clock.now()),
            {fd for fd, link in links.items() if link.is_waiting},
        )
        supervised.attempt("adoption", self._note_ends, ready)
        for fd in ready.difference(pidfds):
            if fd in links:
                link = links[fd]
                supervised.attempt(part_of(link.name), self._hear, link)
            elif fd == self._waker.fileno():
                self._waker.clear()
            elif fd == asking:
                supervised.attempt(_ORPHANS, self._adopt)
            elif fd == lifeline:
                self._is_asked_to_end = True
            else:
                supervised.attempt("zygote", self._hear_zygote)

    def _hear(self, link: ControlLink, *, to_the_end: bool = False) -> None:
        """Send what is left to send; tell the core the next record, or all of them."""
        try:
            if not to_the_end:
                link.flush()
            while (said := link.next()) is not None:
                self._core.on_record(link.name, said)
                if not to_the_end:
                    return
        except Unavailable:
            why = ""  # its end is reported
        except WireError as error:  # not of this version, or damaged
            why = str(error)
        else:
            return
        if not to_the_end:
            self._core.on_deaf(link.name, why)

    def _note_end(self, pid: int, how: ProcessEnd | str) -> None:
        """Tell the core that a process ended, and before that what it said last."""
        for link in self._host.links():
            if link.pid == pid:
                self._hear(link, to_the_end=True)
        self._core.on_ended(pid, how)

    def _note_ends(self, ready: set[int]) -> None:
        how = "an earlier agent had started it" if self._has_zygote else "no zygote"
        for pid in self._adoption.ended(ready):
            self._note_end(pid, f"ended ({how})")

    def _hear_zygote(self) -> None:
        try:
            event = zygote.hear(self._zygote)
        except Unavailable as error:
            # one with threads, as the agent is by now, must not fork another
            self._has_zygote = False
            oom = self._host.explain_kill(self._clock.now())
            self._core.on_no_more_starts(
                f"{error}: containers keep running, but none can be started until "
                f"the agent is started again{oom and '; it '}{oom}"
            )
            return
        if isinstance(event, zygote.ContainerEnded):
            self._note_end(event.pid, ProcessEnd(event.status))
        elif isinstance(event, zygote.NotForked):
            self._core.on_not_born(event.name, event.reason)
        else:
            self._core.on_born(event.name, event.pid)

    def _adopt(self) -> None:
        try:
            while (adopted := self._adoption.next_orphan()) is not None:
                orphan, connection, stats_page = adopted
                name, pid = orphan.container, orphan.pid
                link = self._host.link(name, connection, stats_page)
                if not orphan.is_understood or not self._core.on_orphan(
                    name, pid, link
                ):
                    log.warning("container '%s' (process %d) is not adopted", name, pid)
                    link.close()
                    kill_all({pid})
        except WireError as error:
            raise RunError(
                "something that is not a container of this version of Poise asked to "
                f"be adopted: {error}"
            ) from error

    def _end_all(self) -> None:
        core = self._core
        try:
            core.end()
            while not core.has_ended():
                core.tick()
                self._await_news(self._clock.now() + _ENDING_EVERY)
        finally:
            core.kill_all()


_MOST_FILES = 1 << 16
"""The most descriptors that an agent allows itself. With the usual 1,024, a thousand
silent strangers take them all, and zenoh accepts nobody even after they have left."""


def _allow_files() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, _MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _code(setup: AgentSetup) -> CodeFolder | None:
    """Return the versions of the robot's code; UsageError: they have no place."""
    if not setup.code:
        return None
    try:
        return CodeFolder(Path(setup.code), setup.account)
    except OSError as error:
        raise UsageError(
            f"agent '{setup.computer}' cannot keep code in {setup.code}: "
            f"{error.strerror}; choose another folder with --folder"
        ) from error


def _keys(setup: AgentSetup) -> Credentials | None:
    """Return the agent's keys, which its containers find in their environment."""
    if not setup.keys:
        os.environ.pop(KEYS, None)
        return None
    from poise.wire.credentials import Credentials  # noqa: PLC0415, `ssl` is slow

    keys = Credentials(Path(setup.keys)).check(setup.robot, "agent")
    os.environ[KEYS] = setup.keys if setup.encrypts else ""
    return keys
