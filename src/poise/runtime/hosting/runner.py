"""Runs one component on a thread of its own.

The thread takes the steps to the goal (`LifeCycle`), and runs timers and messages;
calls run on others' threads, in the component's exclusion. `ExecutionGate` pauses both.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from typing import Any

from poise import threads
from poise.clock import ComponentClock, wall_time
from poise.errors import Timeout, last_error
from poise.priority import before_components
from poise.runtime._calls import ComponentCounters
from poise.runtime.component.component import Component, Context, create, set_parameters
from poise.runtime.component.error_report import Errors
from poise.runtime.component.parameters import plain
from poise.runtime.component.ports import ports_of, timers_of, watchers_of
from poise.runtime.component.started_calls import ANSWER, StartedCalls
from poise.runtime.connectors.endpoints import ComponentEndpoints
from poise.runtime.connectors.interface import methods
from poise.runtime.execution.container_lease import LeaseEnd, LeaseEnded
from poise.runtime.execution.counters import Counts, SignedHistogram
from poise.runtime.execution.data_age import DataAges, Stamped
from poise.runtime.execution.exclusion import Exclusion, Redirected, new_chain
from poise.runtime.execution.input_watch import InputWatch
from poise.runtime.execution.mailbox import PortQueue, Work
from poise.runtime.execution.timers import Releases, Timers, release_offset
from poise.runtime.hosting.checkpoints import Checkpoints
from poise.runtime.hosting.handler_times import HandlerTimes
from poise.runtime.hosting.life_cycle import ENDED, ExecutionGate, LifeCycle, TaskNews
from poise.runtime.hosting.output import write_as
from poise.wire.codec import codec
from poise.wire.records.deployment_records import ComponentSpec, LifeCycleGoal
from poise.wire.records.status_records import ComponentStatus, State

log = logging.getLogger(__name__)

_PATIENCE = 1.0
"""How long a timer or message waits to enter before it looks at the goal [s]."""
_BUSY_LIMIT = 60.0
"""A component to be deactivated fails when others stay inside for this time [s]."""
_MOST_MEASURES = 100
"""A component may have this many measures, since each report has all of them."""
_FENCED = 0.02
"""A component whose lease has ended looks so often whether it was extended [s]."""


class Runner:
    """An incarnation of a component with the thread that runs it."""

    def __init__(
        self,
        spec: ComponentSpec,
        implementation: type[Component],
        clock: ComponentClock,
        on_change: Callable[[], None],
    ) -> None:
        self.spec = spec
        self.exclusion = Exclusion(spec.name)
        self.ports = ports_of(implementation)
        self.news = TaskNews(on_change)
        self._turns: deque[Work] = deque()
        self.started = StartedCalls(spec.name, self._later)
        self.component = create(
            implementation,
            Context(
                name=spec.name,
                parameters={**spec.parameters, **spec.changed_parameters},
                devices=spec.devices,
                clock=clock,
                measure=self._measure,
                count_process=self._count_process,
                give_up=self._give_up,
                request=self.news.request,
                calls=self.started,
                listen=lambda source: self.endpoints.mailbox.listen(source),  # noqa: PLW0108, made later
                follows=spec.follows,
                takes_over=lambda: self.life_cycle.goal == "ready",
                age=lambda port: self.endpoints.mailbox.age(port),  # noqa: PLW0108
            ),
        )
        self.counters = ComponentCounters()
        self.outside_calls = Counts()
        self.ages = DataAges(spec.chains, clock)
        self.endpoints = ComponentEndpoints(
            self.component,
            spec.epoch,
            self.ports,
            self.exclusion,
            self.counters,
            self.ages,
            {port: partial(self.news.note_end, port) for port in spec.ends},
        )
        # it may take long to get ready, and others work meanwhile
        self.endpoints.mailbox.hold_up_nobody()
        self.life_cycle = LifeCycle()
        self.gate = ExecutionGate(
            spec.name,
            self.exclusion,
            self.endpoints,
            self.started,
            lambda: self.life_cycle.is_at_work,
            hang=self.hang,
        )
        self.timers = Timers(timers_of(implementation))
        self._watchers = watchers_of(implementation)
        self._inputs: InputWatch | None = None
        self.clock = clock
        self._on_change = on_change
        self._handler: tuple[str, float] | None = None
        self._hook: tuple[str, float] | None = None
        self._measures: dict[str, SignedHistogram] = {}
        self._has_warned_of_measures = False
        self._times: HandlerTimes | None = None
        if spec.weigh:
            ends = self.endpoints.counts_of_calls
            self._times = HandlerTimes(ends, self.started)
            self.endpoints.timing = self._times.timing
        self._errors = Errors(spec.name)
        self._action = spec
        self._changed_parameters = spec.changed_parameters
        # what was set here, where no deployment says so yet; the next incarnation takes
        # it first of all
        self.parameters_set: dict[str, Any] = {}
        self._parameters_handed: Mapping[str, Any] = {}
        # the actions that it was told of; one that comes to take over from another goes
        # on with those of that
        is_new = spec.goal == "active" or spec.fresh
        self.begun = set[int]() if is_new else set(spec.actions)
        self._thread = threads.daemon(self._main, spec.name)
        self.asked_at = clock.now()
        self._cpu_before = 0.0  # of processes that were counted
        self.reason_to_end = ""
        self.bad_end = ""
        """What went wrong as it ended, in words."""
        self.checkpoints: Checkpoints | None = None
        # a target has its state, and is to get what changed since that snapshot
        self.owes_changes = False
        self.lease: LeaseEnd | None = None
        self._start = 0.0
        self._snapshot = 0

    @property
    def copies_ahead(self) -> bool:
        """Whether a target gets its state before the pause, and then what changed."""
        code = type(self.component)
        return code.snapshot_delta is not Component.snapshot_delta

    def start(self) -> None:
        """Start its thread; it goes to the goal by itself."""
        self._thread.start()

    def aim(self, goal: LifeCycleGoal) -> None:
        """Set the goal; harmless when repeated. To be active, a pause ends."""
        self.gate.refuse_pause()
        self.owes_changes = False
        self.life_cycle.aim(goal)
        # in a hook it resumes by itself when that ends, which nobody should wait for
        if goal == "active" and self.life_cycle.state == "active":
            self.gate.resume()
        self.endpoints.mailbox.wake()

    def note_spec(self, spec: ComponentSpec) -> None:
        """Take in an action and parameters, which are taken once it is active."""
        self._action = spec

    def hand_parameters(self, values: Mapping[str, Any]) -> None:
        """Take parameters that were set at its source, before it does anything else."""
        self._parameters_handed = values

    def wait_ended(self, limit: float) -> bool:
        """Wait up to `limit` [s] for its thread to end; whether it did."""
        self._thread.join(limit)
        return not self._thread.is_alive()

    def why_not_ended(self) -> str:
        """Return what keeps its thread from ending, in words."""
        name, now = self.spec.name, self.clock.now()
        what, since = self._handler or self._hook or ("", now)
        runs = f": '{what}' has run for {now - since:.1f} s" if what else ""
        return f"component '{name}' did not end in time{runs}"

    def ends_since(self) -> float | None:
        """Return since when a hook that ends it runs, or is next [s], or None."""
        hook, since = self._hook or ("", self.clock.now())
        is_next = not hook and self.life_cycle.state == "inactive"
        return since if is_next or hook in {"deactivate", "cleanup"} else None

    def has_ended(self) -> bool:
        """Return at once whether its code runs no more."""
        return self.life_cycle.state in ENDED or not self._thread.is_alive()

    def hang(self) -> tuple[str, float]:
        """Return what has not gone on, and for how long [s]: a handler, or a timer."""
        now, handler = self.clock.now(), self._handler
        if handler is not None:
            return f"'{handler[0]}' runs", now - handler[1]
        due = self.timers.next_due()
        if due is None or due > now or self.gate.is_paused or self.is_fenced:
            return "", 0.0
        return "a timer is due and cannot run", now - due

    @property
    def is_fenced(self) -> bool:
        """Whether its lease has ended."""
        return self.lease is not None and self.lease.is_past()

    @property
    def is_paused(self) -> bool:
        """Whether it should work, and its code may not run: it moves."""
        return self.life_cycle.is_at_work and self.gate.is_paused

    def status(self, cpu: float | None = None) -> ComponentStatus:
        """Return what is known of it now."""
        now = self.clock.now()
        handler, since = self._handler or self._hook or ("", now)
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state=self.life_cycle.state,
            error=self._errors.last,
            errors=self._errors.count,
            error_counts=self._errors.counts(),
            handler=handler,
            handler_seconds=now - since,
            hung=self.hang()[1],
            cpu=self._cpu_before + (self.counters.cpu() if cpu is None else cpu),
            start=self._start,
            snapshot=self._snapshot,
            has_state=type(self.component).snapshot is not Component.snapshot,
            copies_ahead=self.copies_ahead,
            requires=self._ports_that("requires"),
            subscribes=self._ports_that("subscribes"),
            keeps={
                port.name: port.queue.size
                for port in self.ports.values()
                if port.queue is not None and port.queue.policy == "keep"
            },
            timers=self.timers.status(now),
            work=self._times.cpu() if self._times else {},
            waits=self._times.waits() if self._times else {},
            chains=self.ages.status(),
            ends=self.news.ends(),
            task_requests=self.news.requests(),
            measures={n: h.summary() for n, h in list(self._measures.items())},
        )

    def _ports_that(self, kind: str) -> tuple[str, ...]:
        return tuple(port.name for port in self.ports.values() if port.kind == kind)

    def _measure(self, name: str, value: float) -> None:
        known = self._measures.get(name)
        if known is None and len(self._measures) < _MOST_MEASURES:
            known = self._measures.setdefault(name, SignedHistogram())
        if known is not None:
            known.add(value)
        elif not self._has_warned_of_measures:
            self._has_warned_of_measures = True
            log.warning(
                "measure '%s' of component '%s' is not counted, nor are further ones: "
                "it has %d others",
                name,
                self.spec.name,
                _MOST_MEASURES,
            )

    def _count_process(self, pid: int) -> None:
        if pid:
            self.counters.watch(pid)
        else:
            self._cpu_before += self.counters.cpu()
            self.counters.begin()

    def _give_up(self, reason: str) -> None:
        self.reason_to_end = f"component '{self.spec.name}': {reason}"
        self._on_change()

    def _main(self) -> None:
        write_as(self.spec.name)
        threads.take_name(self.spec.name)  # what it starts is found by it
        self.counters.begin()
        try:
            while self.life_cycle.state not in ENDED:
                self._go_to_goal()
        finally:
            if self.life_cycle.state not in ENDED:  # a defect ended its thread
                self.life_cycle.enter("failed")
                self._on_change()
            # one that was to end has moved away, or is replaced
            if self.life_cycle.goal != "finalized":
                self.endpoints.fail()
            # nobody waits for what has ended: calls go where the component is now
            self.exclusion.redirect()
            self.counters.end()

    def _go_to_goal(self) -> None:
        step = self.life_cycle.next_step()
        if step is not None and step[0] == "activate" and self.is_fenced:
            self.life_cycle.wait_while_active(_FENCED)
        elif step is not None:
            if step[0] != "deactivate" or self._pause():
                self._step_on(*step)
        elif self.life_cycle.goal == "active":
            self._work()
        else:
            self.counters.note_idle()
            self.life_cycle.wait_for_step()
            self.counters.note_busy()

    def _step_on(self, hook: str, state: State) -> None:
        if hook == "deactivate":
            self.counters.plan([])
            self.timers.stop(self.clock.now())
        elif hook == "activate":
            # the incarnation before it may still be at work, and goes first
            self.endpoints.buffer_until_active()
        # callers wait for one that takes over
        hurry = (
            before_components() if self.life_cycle.goal == "ready" else nullcontext()
        )
        self._hook = hook, self.clock.now()
        try:
            with hurry, self.gate.borrowed(by_hook=True):
                getattr(self.component, hook)()
                if hook == "configure" and self.checkpoints is not None:
                    self._restore(self.checkpoints)
                if hook == "deactivate" and self.spec.weigh:
                    self._weigh()
        # a user's hook may raise anything
        except BaseException as error:  # noqa: BLE001
            if hook == "deactivate" and isinstance(error, LeaseEnded):
                # one that may say no farewell keeps its state
                log.warning("'%s' ended early: %s", hook, error)
            else:
                self._note_failure(hook, error)
                self._clean_up_after(hook)
                state = "failed"
        self._hook = None
        if state == "active":
            self._start_timers()
        elif hook == "configure":
            self._start = self.clock.now() - self.asked_at
        elif hook == "deactivate":
            self.news.begin()
            self.endpoints.mailbox.hold_up_nobody()  # and keep no more than it keeps
        self.life_cycle.enter(state)
        self.gate.resume()
        self._on_change()

    def _start_timers(self) -> None:
        if self.checkpoints is not None:  # what it brought along is not kept yet
            self.checkpoints.due = self.clock.now()
        elapsed = wall_time() - release_offset(self.spec.name)
        self.counters.plan(self.timers.start(self.clock.now(), elapsed))

    def _note_failure(self, hook: str, error: BaseException) -> None:
        self._errors.note(hook, error, self.clock.now())
        if self.life_cycle.goal == "finalized":  # its status is not looked at any more
            raised = last_error(self._errors.last)
            self.bad_end = f"'{hook}' of component '{self.spec.name}' raised {raised}"

    def _pause(self) -> bool:
        """Pause before it is deactivated; False: it goes on, or has failed."""
        until = self.clock.now() + _BUSY_LIMIT
        while not self.gate.is_paused and self.life_cycle.goal != "active":
            try:
                self.gate.pause_oneself(_PATIENCE, self._run_waiting)
            except Timeout as error:
                log.warning("%s", error)
                if self.life_cycle.goal == "finalized":
                    self.gate.pause_for_good()
                    name = self.spec.name
                    self.bad_end = f"a call to component '{name}' ran as it ended"
                elif self.clock.now() > until:
                    self._note_failure("deactivate", error)
                    self.life_cycle.enter("failed")
                    self._on_change()
                    return False
        return self.gate.is_paused

    def _run_waiting(self) -> bool:
        """Run what waits for its turn; return False when nothing may: no lease."""
        while self._turns and not self.is_fenced:
            try:
                self.exclusion.enter(new_chain(), _PATIENCE)
            except (Timeout, Redirected):
                break
            self._run_turn()
        return not self.is_fenced

    def _run_turn(self) -> None:
        what, method = self._turns.popleft()
        self._run(method, what)
        if what == ANSWER:  # what else nothing asked for is no job
            self.counters.note_done()

    def _weigh(self) -> None:
        state = self.component.snapshot()
        self._snapshot = 0 if state is None else codec(Any).size_of(state)

    def _restore(self, checkpoints: Checkpoints) -> None:
        age = checkpoints.restore(self.component, self.endpoints.latest)
        if age is not None:
            self.begun = set(self.spec.actions)
            text = "component '%s' continues from its state of %.1f s ago"
            log.warning(text, self.spec.name, age)

    def _clean_up_after(self, hook: str) -> None:
        if hook == "cleanup":
            return
        self._hook = "cleanup", self.clock.now()
        try:
            with self.gate.borrowed(by_hook=True):
                self.component.cleanup()
        except BaseException:  # a user's hook may raise anything
            log.exception("component '%s': cleanup after an error", self.spec.name)

    def _work(self) -> None:
        """Run the timers that are due, then at most one message."""
        spec = self._action
        if self._parameters_handed and self._enter():
            handed, self._parameters_handed = self._parameters_handed, {}
            self.parameters_set = dict(handed)
            self._run(self._apply_parameters, "reconfigure", handed)
        if spec.changed_parameters != self._changed_parameters and self._enter():
            self._changed_parameters = told = spec.changed_parameters
            newer = {n: v for n, v in self.parameters_set.items() if told.get(n) != v}
            changes = {n: v for n, v in told.items() if n not in newer}
            self.parameters_set = newer
            self._run(self._apply_parameters, "reconfigure", changes)
        self._begin_actions(spec.actions)
        while self._turns and self._enter():
            self._run_turn()
        for releases in self.timers:
            if releases.due <= self.clock.now():
                self._run_timer(releases)
        due = self.timers.next_due()
        if self.checkpoints is not None:
            due = self._checkpoint_if_due(self.checkpoints, due)
        limit = None if due is None else max(0.0, due - self.clock.now())
        self.counters.note_idle()
        work = self.endpoints.mailbox.work(limit)
        self.counters.note_busy()
        if isinstance(work, tuple):
            self._turns.append(work)
        elif work is not None and self._enter():
            self._deliver(work)
        elif work is not None:
            self.endpoints.mailbox.offer(work)

    def _begin_actions(self, actions: Mapping[int, str]) -> None:
        for number, action in actions.items():
            if number not in self.begun and self._enter():
                self.begun = {number, *self.begun.intersection(actions)}
                self.news.begin()
                self._run(self.component.begin, "begin", action)

    @property
    def watches_inputs(self) -> bool:
        """Whether it wants to know who publishes to it, and is at work."""
        return bool(self._watchers) and self.life_cycle.is_at_work

    def note_inputs(self, joined: Mapping[str, bool]) -> bool:
        """Take in which subscribed ports have a source; return whether to look soon."""
        now = self.clock.now()
        if self._inputs is None:
            self._inputs = InputWatch({port for _, port in self._watchers}, now)
        for event, port in self._inputs.note(joined, now):
            for name in self._watchers.get((event, port), ()):
                self._turns.append((f"{event} {port}", getattr(self.component, name)))
                self.endpoints.mailbox.wake()
        return self._inputs.is_pending()

    def _later(self, turn: Callable[[], object]) -> None:
        """Run something on its thread, as soon as nothing else of it runs."""
        self.counters.note_asked()
        self._turns.append((ANSWER, turn))
        self.endpoints.mailbox.wake()

    def _apply_parameters(self, changes: Mapping[str, Any]) -> None:
        """Take parameters that were set at another place, or while it was away."""
        now = plain(self.component.parameters)
        if any(now.get(name) != value for name, value in changes.items()):
            set_parameters(self.component, changes)

    def _checkpoint_if_due(self, checkpoints: Checkpoints, due: float | None) -> float:
        """Take a checkpoint when it is time; return when there is something to do."""
        if checkpoints.due <= self.clock.now() and self._enter():
            self._run(self._write_checkpoint, "checkpoint", checkpoints)
        return checkpoints.due if due is None else min(due, checkpoints.due)

    def _write_checkpoint(self, checkpoints: Checkpoints) -> None:
        if self.owes_changes:  # they would count from its snapshot
            checkpoints.postpone()
        else:
            checkpoints.write(self.component, self.endpoints.latest)

    def _run_timer(self, releases: Releases) -> None:
        if not self._enter():
            return
        began = self.clock.now()
        release = releases.begin(began)
        name = releases.timer.name
        self._run(getattr(self.component, name), name, is_timer=True)
        self.counters.note_done()
        releases.end(release, began, self.clock.now())

    def _deliver(self, inbox: PortQueue) -> None:
        entry = inbox.pop()
        if entry is None:  # it was dropped for a newer one
            self.exclusion.leave()
            return
        port = self.ports[inbox.port]
        tag, value = entry
        taken = None
        if type(value) is Stamped:
            taken, value = value, value.value
        if port.kind == "subscribes":
            handler = getattr(self.component, port.handler)
            self._run(handler, port.name, value, taken=taken)
        else:
            method = getattr(self.component, methods(port.type)[tag].name)
            self._run(method, port.name, *value, taken=taken)
        self.counters.note_done()

    def _enter(self) -> bool:
        """Begin a chain and wait to enter; False when the goal has changed."""
        chain = new_chain()
        while self.life_cycle.goal == "active":
            try:
                self.exclusion.enter(chain, _PATIENCE)
            except Timeout:
                continue
            except Redirected:
                # the incarnation that took over does the work; the container ends us
                self.life_cycle.wait_while_active(_PATIENCE)
                continue
            if not self.is_fenced:
                return True
            self.exclusion.leave()
            self.life_cycle.wait_while_active(_FENCED)
        return False

    def _run(
        self,
        method: Callable[..., Any],
        what: str,
        *args: object,
        taken: Stamped | None = None,
        is_timer: bool = False,
    ) -> None:
        """Run user code in the exclusion that was entered, and leave it."""
        self._handler = what, self.clock.now()
        began = self._times.begin() if self._times else None
        try:
            if self.spec.chains:
                is_later = is_timer or what == ANSWER
                self.ages.run(method, args, taken=taken, is_later=is_later)
            else:
                method(*args)
        except LeaseEnded as error:  # its code did nothing wrong
            log.warning("'%s' ended early: %s", what, error)
        # a user's method may raise anything
        except BaseException as error:  # noqa: BLE001
            self._errors.note(what, error, self.clock.now())
        else:
            if self._times and began:
                self._times.end(what, began)
        finally:
            self._handler = None
            self.exclusion.leave()
            self.gate.note_done()
