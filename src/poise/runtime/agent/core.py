"""What an agent decides. It reaches the world through its `Surroundings` alone.

An error in one part is shown, and stops nothing else (`SupervisedParts`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import inf
from typing import NamedTuple, TypeVar

from msgspec import structs

from poise.runtime.agent import allowed_code
from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.agent.inbox import SupervisedParts
from poise.runtime.agent.standby_watch import StandbyWatch
from poise.runtime.agent.surroundings import (
    AgentSetup,
    AgentState,
    ContainerControl,
    Reply,
    Surroundings,
)
from poise.runtime.supervision.adopted_containers import ADOPT_LIMIT
from poise.runtime.supervision.container_processes import (
    STOP_LIMIT,
    PendingRequests,
    ProcessEnd,
)
from poise.runtime.supervision.health import HealthRecords, Silence
from poise.runtime.supervision.supervisor import Supervisor, part_of
from poise.wire.heartbeats import Contacts
from poise.wire.records.code_records import CodePart, InstallCode
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.heartbeat_records import Clocks
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    CheckpointCopy,
    Claim,
    Claimed,
    ManagerRequest,
    ReadOutput,
    Refused,
)
from poise.wire.records.status_records import (
    ENDING_LIMIT,
    AgentStatus,
    ContainerRequest,
    FromContainer,
)

T = TypeVar("T")

REPORT_EVERY = 0.5
"""A status goes out at least this often [s]."""
_MISSES_EVERY = 0.2
"""While deadlines are missed, it goes out this often [s]."""


class _Part(NamedTuple):
    """A part of each tick, and when it is due though nothing happens [s], if ever."""

    name: str
    act: Callable[[], object]
    due: Callable[[], float] | None = None


class AgentCore:
    """The logic of the agent of one computer."""

    def __init__(
        self, setup: AgentSetup, world: Surroundings, left: AgentState
    ) -> None:
        self.is_ready = False
        self._has_news = True
        self._due = 0.0
        self._setup = setup
        self._world = world
        self._clock = world.clock
        self._born = world.clock.now()
        self._end_limit = inf
        self.supervised = SupervisedParts(world.clock, world.wall)
        self.supervisor = Supervisor(
            world.host,
            world.clock,
            self.supervised,
            HealthRecords(world.clock.now, world.wall),
            world.random,
            world.adoption.awaits,
            world.disk.checkpoint_age,
        )
        if left.wanted is not None:
            self.supervisor.deploy(left.wanted, is_left=True)
            self._keep_only(left.wanted)
        self._pending = PendingRequests(
            self.supervisor.processes, self.supervisor.health.how_ended
        )
        self.fence = Fence(
            setup.robot,
            setup.computer,
            self.wake,
            world.say,
            left.claim.manager if left.claim else None,
            left.token,
            world.wall,
        )
        self.heartbeats = HeartbeatExchange(
            setup.computer,
            Contacts(setup.robot, setup.computer, world.key),
            self.fence,
            world.clock,
            world.heartbeats,
            self.supervisor.extend_lease,
            world.asleep,
        )
        self.heartbeats.resume(left.claim)
        if world.adoption.is_settled():  # nothing has run here meanwhile
            self.heartbeats.note_lapsed()
        self.standby = StandbyWatch(setup.computer, self.heartbeats, self.fence, world)
        self._last = self._status()
        self._published = (0, self._last.states), self._last.missed
        self._published_at = self._report_at = 0.0
        self._parts = self._table()

    def wake(self) -> None:
        """Let `tick` look at everything soon; from any thread."""
        self._has_news = True
        self._world.wake()

    def on_request(self, request: ManagerRequest, reply: Reply) -> None:
        """Do what a manager asks for, or refuse it; it is answered once."""
        # steps and taps change nothing that a tick does, and callers wait for them
        self._has_news |= not isinstance(request.request, ContainerRequest)
        try:
            self._attend(request, reply)
        except Exception as error:  # noqa: BLE001, it is logged and shown
            self.supervised.report("requests", error)
            why = f"an internal error in its agent, a bug in Poise: {error!r}"
            if isinstance(request.request, ContainerRequest):
                reply(StepsFailed(request.request.number, why))
            else:
                reply(Refused(why))

    def on_record(self, container: str, record: FromContainer) -> None:
        """Take in what a container says."""
        if self.fence.is_cut_off or self.supervisor.is_news(container, record):
            self._has_news = True
        note = self.supervisor.note
        outcome = self.supervised.attempt(part_of(container), note, container, record)
        if outcome is not None:
            self.supervised.attempt("steps", self._pending.answer, outcome)

    def on_deaf(self, container: str, why: str) -> None:
        """Kill a container that cannot be understood, or that closed its connection."""
        self._about(container, self.supervisor.note_deaf, container, why)

    def on_born(self, container: str, pid: int) -> None:
        """Note that the process of a container began."""
        self._about(container, self.supervisor.note_born, container, pid)

    def on_not_born(self, container: str, why: str) -> None:
        """Note that the process of a container could not begin."""
        self._about(container, self.supervisor.note_not_born, container, why)

    def on_ended(self, pid: int, how: ProcessEnd | str) -> None:
        """Note that a process ended; until then it may have written checkpoints."""
        name, unwanted = self.supervisor.name_of(pid), self.supervisor.unwanted_of(pid)
        self._about(name, self.supervisor.note_ended, pid, how)
        if unwanted:
            self._about(name, self._world.disk.remove_checkpoints, unwanted)

    def on_orphan(self, container: str, pid: int, control: ContainerControl) -> bool:
        """Adopt a container of an earlier agent; return whether that is done."""
        return self._about(container, self._adopt, container, pid, control) or False

    def on_silence(self, silence: Silence) -> None:
        """Note that a container does not respond, or that it responds again."""
        self._about(silence.container, self.supervisor.note_silence, silence)

    def on_no_more_starts(self, why: str) -> None:
        """Note that no container can be started or seen to end by its host."""
        self.supervisor.trouble = why
        for process in self.supervisor.processes.values():
            if process.pid:
                self._about(process.name, self._world.adoption.watch, process.pid)

    def tick(self) -> None:
        """Do what is due; harmless when nothing is."""
        is_idle = self.is_ready and not self._has_news and self._end_limit == inf
        if is_idle and self._clock.now() < self._due:
            return
        self._has_news = False
        for part in self._parts:
            self.supervised.run(part.name, part.act)
        self._due = self._next_due()

    def moment(self) -> float:
        """Return when `tick` is due though nothing more happens [s]."""
        return -inf if self._has_news else self._due

    def _next_due(self) -> float:
        moments = [self._end_limit]
        for part in self._parts:
            if part.due is None:
                continue
            due = self.supervised.run(part.name, part.due) or -inf
            moments.append(max(due, self.supervised.again_at(part.name)))
        return min(moments)

    def end(self) -> None:
        """End every container in stages, in the ticks until `has_ended`."""
        self._has_news = True
        self._end_limit = self._clock.now() + ENDING_LIMIT + STOP_LIMIT + 1
        self._parts = tuple(
            part for part in self._parts if part.name in {"steps", "containers"}
        )
        self.supervised.attempt("adoption", self._world.adoption.close)
        self.supervised.attempt("state", self._world.disk.forget)
        self.supervised.attempt("leader", self.standby.close)
        self.supervisor.end()

    def leave(self) -> None:
        """Say that the next agent starts soon here, and adopts the containers."""
        self._keep_state()
        self._world.publish(structs.replace(self._status(), is_leaving=True))

    def has_ended(self) -> bool:
        """Return whether no container runs any more, or they had time enough."""
        is_late = self._clock.now() >= self._end_limit
        return is_late or not self.supervisor.processes

    def kill_all(self) -> None:
        """Kill the containers that still run."""
        for process in list(self.supervisor.processes.values()):
            self._about(process.name, process.kill)

    def _table(self) -> tuple[_Part, ...]:
        adoption, standby, pending = self._world.adoption, self.standby, self._pending
        return (
            _Part("state", self._keep_state),
            _Part("lease", self._note_lease),
            _Part(
                "leader", lambda: standby.look(is_over=self._is_over()), standby.moment
            ),
            _Part("steps", lambda: pending.give_up(self._clock.now()), pending.moment),
            _Part("adoption", adoption.give_up, adoption.moment),
            _Part("containers", self.supervisor.reconcile, self.supervisor.moment),
            _Part("clocks", self._tell_clocks),
            _Part("status", self._report, lambda: self._report_at),
        )

    def _about(self, container: str, work: Callable[..., T], *args: object) -> T | None:
        self._has_news = True
        return self.supervised.attempt(part_of(container), work, *args)

    def _adopt(self, container: str, pid: int, control: ContainerControl) -> bool:
        if control.is_lease_past():
            self.heartbeats.note_lapsed()
        return self.supervisor.adopt(container, pid, control)

    def _attend(self, asked: ManagerRequest, reply: Reply) -> None:
        request, refusal = asked.request, self.fence.refusal(asked.token)
        wanted = self.supervisor.wanted
        if isinstance(request, Claim):
            reply(self._claimed(request, asked.token))
        elif isinstance(request, CodePart | InstallCode):
            self._serve_code(request, reply)
        elif isinstance(request, ContainerRequest):
            if refusal:
                reply(StepsFailed(request.number, refusal))
            else:
                self._pending.pass_on(request, reply, self._clock.now())
                self._due = min(self._due, self._pending.moment())
        elif refusal:
            reply(Refused(refusal))
        elif isinstance(request, ReadOutput | CheckpointCopy):
            self._world.disk.serve(request, reply)
        elif wanted and request.generation < wanted.generation:
            older = f"generation {request.generation} is older than "
            reply(Refused(f"{older}{wanted.generation}"))
        elif request.containers and self._setup.is_witness:
            computer = self._setup.computer
            reply(Refused(f"'{computer}' is a witness: `poise agent` runs components"))
        elif why := allowed_code.refusal(
            request.containers, self._setup.allow, self._versions()
        ):
            reply(Refused(why))
        else:
            self.supervisor.deploy(request)
            self.heartbeats.note_told()
            self._keep_only(request)
            reply(Accepted())

    def _keep_only(self, wanted: Deployment) -> None:
        self._world.disk.keep_only(wanted)
        if self._world.code is not None:
            self._world.code.keep(wanted.code)

    def _serve_code(self, request: CodePart | InstallCode, reply: Reply) -> None:
        code = self._world.code
        if code is None:
            reply(Refused("it runs no components, and takes no code"))
        elif why := allowed_code.refusal_of_code(self._setup.allow):
            reply(Refused(why))
        else:
            code.serve(request, partial(self._tell_of_code, reply))

    def _tell_of_code(self, reply: Reply, answer: Answer) -> None:
        """Let managers know of a new version, and answer."""
        self.wake()
        reply(answer)

    def _versions(self) -> tuple[str, ...]:
        return self._world.code.versions() if self._world.code is not None else ()

    def _claimed(self, claim: Claim, token: int) -> Claimed | Refused:
        """Obey a manager from now on, or say why not."""
        beats, fence, silent = self.heartbeats, self.fence, self.heartbeats.silent()
        is_next = claim.election is not None or fence.succeeds(claim.manager.key)
        is_held = beats.is_held() and is_next
        is_unheard = self._clock.now() >= beats.leader_silent_from()
        refused = fence.claim(claim, token, is_unheard=is_unheard)
        if refused is None and not claim.is_poll:
            if not is_held:  # what ran here may run elsewhere by now
                fence.lapse()
            beats.obey(claim)
            self._world.disk.resend()
        return refused or Claimed(self.supervisor.wanted, fence.is_cut_off, silent)

    def _keep_state(self) -> None:
        self._world.disk.keep(
            AgentState(
                gateway=self._world.gateway,
                claim=self.heartbeats.claim,
                token=self.fence.token,
                wanted=self.supervisor.wanted,
            )
        )

    def _is_over(self) -> bool:
        """Return whether nothing is to run on the robot, or nobody has said so."""
        wanted = self.supervisor.wanted
        return wanted is None or wanted.is_last

    def _note_lease(self) -> None:
        self.fence.update()
        self.supervisor.note_cut_off(is_cut_off=bool(self.fence.cut_off))

    def _tell_clocks(self) -> None:
        beats = self.heartbeats
        self.supervisor.send_clocks(Clocks(beats.clocks, beats.silent_computers))

    def _report(self) -> None:
        if not self.is_ready:
            if not self._knows_containers():
                self._report_at = self._born + ADOPT_LIMIT
                return
            self._world.appear()
            self.is_ready, self._report_at = True, self._clock.now()
        try:
            self._last = self._status()
        except Exception:  # what went wrong is said with what was known last
            self._last = structs.replace(self._last, errors=self.supervised.errors())
            raise
        finally:
            self._publish(self._last)

    def _publish(self, status: AgentStatus) -> None:
        """Publish a status if it says something new, or if it is due."""
        now, due, (known, missed) = self._clock.now(), self._report_at, self._published
        if status.missed != missed:
            due = min(due, self._published_at + _MISSES_EVERY)
        # a manager that arrives from here on gets another one
        news = self.fence.arrivals, status.states
        if news != known or now >= due:
            self._world.publish(status)
            self._published = news, status.missed
            self._published_at, due = now, now + REPORT_EVERY
        self._report_at = due

    def _knows_containers(self) -> bool:
        """Return whether all that an earlier agent left have reported, or could."""
        processes = self.supervisor.processes.values()
        is_settled = self._world.adoption.is_settled()
        is_known = is_settled and all(process.status for process in processes)
        return is_known or self._clock.now() >= self._born + ADOPT_LIMIT

    def _status(self) -> AgentStatus:
        world, supervisor, wanted = self._world, self.supervisor, self.supervisor.wanted
        statuses, usage = supervisor.statuses(), world.usage()
        claim = self.heartbeats.claim
        # a lack of descriptors, say, is the cause of both
        trouble = world.trouble() or world.disk.trouble()
        troubles = supervisor.trouble, trouble, self.standby.trouble
        return AgentStatus(
            version=world.version,
            computer=self._setup.computer,
            pid=world.pid,
            key=world.key,
            took_over=tuple(world.adoption.adopted),
            generation=wanted.generation if wanted else 0,
            is_at_work=not self._is_over(),
            has_standbys=claim is not None and claim.election is not None,
            token=self.fence.token,
            manager=self.fence.manager,
            uptime=self._clock.now() - self._born,
            cpu=world.cpu() + supervisor.cpu_of_ended + sum([s.cpu for s in statuses]),
            load=sum([use.cpu for use in usage.values()]),
            memory=sum([use.memory for use in usage.values()]),
            gateway=world.gateway,
            trouble="; ".join(filter(None, troubles)),
            notice=world.notice(),
            errors=self.supervised.errors(),
            cpu_weights=world.host.cpu_weights,
            platform=world.platform,
            cores=world.cores,
            computer_memory=world.computer_memory,
            code=self._versions(),
            containers=statuses,
            faults=supervisor.health.faults(),
            health=supervisor.records(usage),
            clocks=self.heartbeats.clocks,
            cut_off=self.fence.cut_off,
            unmanaged=self.fence.unmanaged,
            links=self.heartbeats.links(),
        )
