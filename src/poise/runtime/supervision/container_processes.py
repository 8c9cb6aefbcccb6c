"""The containers of an agent: what each should be, and what it is."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Mapping

from msgspec import Struct

from poise.errors import Timeout, Unavailable, last_error, signal_name
from poise.runtime.agent.surroundings import ContainerControl, Reply
from poise.runtime.supervision.health import Silence
from poise.wire.codec import WireError
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.heartbeat_records import Clocks
from poise.wire.records.migration_records import MigrationSteps, StepsFailed
from poise.wire.records.request_records import MOST_PACKED, PortAnswer, PortRequest
from poise.wire.records.status_records import (
    ComponentStatus,
    ContainerAnswer,
    ContainerFailure,
    ContainerRequest,
    ContainerStatus,
    FromContainer,
    ToContainer,
)

STOP_LIMIT = 2.0
"""A container that was asked to end, and whose heart has not beaten for this time [s],
is killed: it beats while hooks of its components run."""


class ContainerProcess:
    """A running container, from the agent's side."""

    def __init__(
        self, spec: ContainerSpec, control: ContainerControl, pid: int = 0
    ) -> None:
        self.name = spec.name
        self.is_adopted = bool(pid)
        self.spec = spec
        self.control = control
        self.pid = 0
        self.status: ContainerStatus | None = None
        self.silence: Silence | None = None
        self.silent_since = 0.0
        self.kill_at = float("inf")
        self.is_stopping = False
        self._beat: int | None = None
        self.is_deaf = False
        self._why_ended = ""
        self._clocks = Clocks({})
        if pid:
            self.note_born(pid)
        else:
            self._send(spec)

    def note_born(self, pid: int) -> None:
        """Take note of its process; raises as `ContainerControl.note_born`."""
        self.pid = pid
        self.control.note_born(pid)
        if self.is_deaf:
            self.kill()

    def is_fenced(self) -> bool:
        """Return whether its leased components may not act; False before its birth."""
        return bool(self.pid) and self.control.is_lease_past()

    def runs_only(self, wanted: ContainerSpec | None) -> bool:
        """Return whether it says of no component that is not wanted."""
        if wanted is None:
            return False
        if self.status is None:  # one that was adopted may run anything
            return not self.is_adopted
        known = {component.key for component in wanted.components}
        return all(component.key in known for component in self._components())

    def deploy(self, spec: ContainerSpec) -> None:
        """Tell it what it should be now, if that changed."""
        if self.is_deaf or spec is self.spec:
            return
        is_new = spec != self.spec
        self.spec = spec  # also if it is equal: then it is the same the next time
        if is_new:
            self._send(spec)

    def send_clocks(self, clocks: Clocks) -> None:
        """Tell it of other computers, if that is new and it listens."""
        if clocks != self._clocks and not self.is_deaf and not self.silence:
            self._clocks = clocks
            self._send(clocks)

    def pass_on(self, steps: ContainerRequest) -> None:
        """Let it take steps of a migration, or read a tap."""
        if not self.is_deaf:
            self._send(steps)

    @property
    def hung_at(self) -> float:
        """When it does not respond for longer than its components allow [s]."""
        limits = [c.restart_when_hung for c in self.spec.components]
        silence = self.silence
        if silence is None or silence.is_starved or self.is_deaf or not any(limits):
            return float("inf")
        return self.silent_since + min(limit for limit in limits if limit)

    def is_stuck(self) -> bool:
        """Return whether it does not respond, and not only for lack of CPU."""
        silence = self.silence
        return (
            silence is not None
            and not silence.is_starved
            and silence.heartbeat == self.control.heartbeat()
        )

    def note(self, what: FromContainer) -> ContainerAnswer | None:
        """Take in what it says; return the outcome of a step, if it is one."""
        if isinstance(what, ContainerStatus):
            self.status = what
            return None
        if isinstance(what, ContainerFailure):
            self._why_ended = what.reason
            return None
        return what

    def incarnations(self) -> set[tuple[str, int]]:
        """Return the name and epoch of what it runs or ran last, as far as known."""
        told = {c.key for c in self.spec.components}
        return told | {c.key for c in self._components()}

    def leased_at_work(self, since: float) -> list[str]:
        """Return the leased components that it has said since then [s] are active."""
        if self.status is None or self.status.at < since:
            return []
        leased = {c.key for c in self.spec.components if c.leased}
        return sorted(
            c.name
            for c in self._components()
            if c.state == "active" and c.key in leased
        )

    def keep_limits(self, now: float) -> None:
        """Kill it when it takes too long to end, or to respond."""
        if self.kill_at <= now:
            self._keep_stop_limit(now)
        if self.silence and self.hung_at <= now:
            self.give_up(f"it does not respond: {self.silence.reason}")

    def stop(self, now: float) -> None:
        """Ask it to end at `now` [s], or kill it if it is silent; once is enough."""
        if self.pid and not self.is_stopping:
            self.is_stopping = True
            self.kill_at = now + (0.0 if self.silence else STOP_LIMIT)
            self._beat = self.control.heartbeat()
            self.control.signal(signal.SIGTERM)

    def _keep_stop_limit(self, now: float) -> None:
        """Kill it, unless its heart beats, for then it ends by itself."""
        before, self._beat = self._beat, self.control.heartbeat()
        if self._beat != before and not self.silence:
            self.kill_at = now + STOP_LIMIT
        else:
            silence = f": {self.silence.reason}" if self.silence else ""
            why = silence or f" for {STOP_LIMIT:g} s"
            self._why_ended = self._why_ended or f"it did not respond{why}"
            self.kill()

    def kill(self) -> None:
        """End it now, or as soon as it is born."""
        self.kill_at = float("inf")
        if self.pid:
            self.control.signal(signal.SIGKILL)

    def last_error(self) -> str:
        """Return the last lines of the errors that it ended with, or nothing."""
        failed = [c for c in self._components() if c.error and c.state == "failed"]
        errors = [f"{c.name}: {last_error(c.error)}" for c in failed]
        return "; ".join(filter(None, [*errors, self._why_ended]))

    @property
    def why_late(self) -> str:
        """Why it did not end in time when it was asked to, in words; empty: it did."""
        return self._why_ended if self.is_stopping else ""

    def loss(self, age_of: Callable[[str, int], float | None]) -> str:
        """Return what became of the states of its components, in words."""
        active = [c for c in self._components() if c.state == "active" and c.has_state]
        ages = {c.name: age_of(*c.key) for c in active}
        keeping = {c.name for c in self.spec.components if c.checkpoint}
        lost = sorted(n for n, age in ages.items() if age is None and n not in keeping)
        parts = [
            f"'{name}' restarts with its state of {age:.1f} s ago"
            if age is not None
            else f"'{name}' restarts: it is not known whether it had kept a state yet"
            for name, age in sorted(ages.items())
            if name not in lost
        ]
        if lost:
            names = ", ".join(f"'{name}'" for name in lost)
            restart = "it restarts" if len(lost) == 1 else "they restart"
            parts.append(f"the state of {names} is gone: {restart}")
        return "; ".join(parts)

    def may_be_oom(self, how: ProcessEnd | str) -> bool:
        """Return whether the kernel may have ended it, or one of its commands."""
        has_command = any(component.command for component in self.spec.components)
        return isinstance(how, ProcessEnd) and (how.is_kill or has_command)

    def give_up(self, why: str = "") -> None:
        """Listen no more: it is ending, or stuck. The zygote reports its end."""
        self.is_deaf = True
        if why and not self._why_ended:
            self._why_ended = f"its agent gave it up: {why}"
        self.kill()

    def _components(self) -> tuple[ComponentStatus, ...]:
        return self.status.components if self.status else ()

    def _send(self, what: ToContainer) -> None:
        try:
            self.control.send(what)
        except (Timeout, Unavailable, WireError) as error:
            self.give_up("" if isinstance(error, Unavailable) else str(error))


class ProcessEnd(Struct, frozen=True):
    """How a process ended, for people."""

    status: int

    @property
    def is_kill(self) -> bool:
        """Whether it was killed."""
        return (
            os.WIFSIGNALED(self.status) and os.WTERMSIG(self.status) == signal.SIGKILL
        )

    def __str__(self) -> str:
        if os.WIFSIGNALED(self.status):
            return f"was killed by {signal_name(os.WTERMSIG(self.status))}"
        return f"ended with exit code {os.waitstatus_to_exitcode(self.status)}"


class _Pending(Struct, frozen=True):
    request: ContainerRequest
    reply: Reply
    limit: float


class PendingRequests:
    """Steps, taps, calls and messages that containers have not answered yet."""

    def __init__(
        self,
        processes: Mapping[str, ContainerProcess],
        how_ended: Callable[[str], str],
    ) -> None:
        self._processes = processes
        self._how_ended = how_ended
        self._pending: dict[int, _Pending] = {}

    def pass_on(self, request: ContainerRequest, reply: Reply, now: float) -> None:
        """Pass a request, which came at `now` [s], to its container."""
        process = self._processes.get(request.container)
        if process is None or process.is_deaf:
            reason = f"container '{request.container}' does not run"
            if isinstance(request, PortRequest):  # it may be asked again
                reply(PortAnswer(number=request.number, outcome="away", reason=reason))
            else:
                reply(StepsFailed(request.number, reason))
            return
        if process.is_stuck():
            reply(StepsFailed(request.number, _why_silent(process)))
            return
        if isinstance(request, PortRequest) and self._is_full(request):
            reason = f"container '{request.container}' has not taken earlier requests"
            reply(PortAnswer(number=request.number, outcome="late", reason=reason))
            return
        process.pass_on(request)
        self._pending[request.number] = _Pending(request, reply, now + request.limit)

    def _is_full(self, request: PortRequest) -> bool:
        """Return whether what waits for its container would be too much with it."""
        waiting = [p.request for p in self._pending.values()]
        size = sum(
            r.value.size
            for r in waiting
            if isinstance(r, PortRequest) and r.container == request.container
        )
        return size + request.value.size > 2 * MOST_PACKED

    def answer(self, outcome: ContainerAnswer) -> None:
        """Answer with an outcome, unless that was answered before."""
        pending = self._pending.pop(outcome.number, None)
        if pending is not None:
            pending.reply(outcome)

    def give_up(self, now: float) -> None:
        """Answer for containers that are gone, silent or too slow at `now` [s]."""
        for pending in list(self._pending.values()):
            container = pending.request.container
            process = self._processes.get(container)
            if process is None:
                reason = f"container '{container}' {self._how_ended(container)}"
            elif process.is_deaf and now < pending.limit:
                continue  # how it ended is heard next
            elif process.is_stuck():
                reason = _why_silent(process)
            elif now >= pending.limit:
                late = _why_late(pending.request)
                reason = _why_silent(process) if process.silence else late
            else:
                continue
            self.answer(StepsFailed(pending.request.number, reason))

    def moment(self) -> float:
        """Return when the next request is given up [s]."""
        limits = (pending.limit for pending in self._pending.values())
        return min(limits, default=float("inf"))


def _why_late(request: ContainerRequest) -> str:
    late = f"container '{request.container}' took over {request.limit:.3g} s"
    if not isinstance(request, MigrationSteps) or not request.steps:
        return late
    steps = dict.fromkeys(f"'{step.name}'" for step in request.steps)
    return f"{late} for {', '.join(steps)}"


def _why_silent(process: ContainerProcess) -> str:
    why = process.silence.reason if process.silence else ""
    return f"container '{process.name}' does not respond: {why}"
