"""One incarnation of a modelled component: its life cycle, its turns, its mailbox."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Literal

from poise.runtime.component.ports import Timer
from poise.runtime.connectors.overtaken_sources import OvertakenSources
from poise.runtime.execution.data_age import DataAges
from poise.runtime.execution.timers import Timers
from poise.simulation.components.channels import Incoming
from poise.simulation.components.ledger import WorkingIncarnation
from poise.simulation.components.models import MOST_KEPT, drawn
from poise.simulation.components.turn import Turn
from poise.wire.records.deployment import ComponentSpec
from poise.wire.records.status import ComponentStatus, State

if TYPE_CHECKING:
    from poise.simulation.components.container import SimulatedContainer

Goal = Literal["inactive", "ready", "active", "finalized"]


class SimulatedComponent:
    """An incarnation in a container.

    Attributes
    ----------
    is_paused
        Whether a migration lets it start nothing.
    turn
        The handler that runs; None: none does.
    markers
        Connector -> the last migration whose marker came over it.
    cpu
        Work of its handlers so far [core-seconds].
    asked, done
        Messages, calls and releases that came, and that were ended.
    """

    def __init__(self, container: SimulatedContainer, spec: ComponentSpec) -> None:
        self.spec = spec
        world, process = container.world, container.process
        self.model = world.model_of(spec.name)
        computer = process.computer.name
        self.who = WorkingIncarnation(spec.name, spec.epoch, computer, process.pid)
        self.container = container
        self.state: State = "unconfigured"
        self.goal: Goal = "inactive"
        self.is_paused = False
        self.is_in_migration = False
        self.turn: Turn | None = None
        self.cpu = 0.0
        self.asked = self.done = self.drops = 0
        self.credit: dict[tuple[str, str], float] = {}
        self.markers: dict[str, int] = {}
        self.overtaken = OvertakenSources()
        self.mailbox: deque[Incoming] = deque()
        self.timers = Timers(
            {each.timer.name: each.timer for each in self.model.timers}
        )
        self.ages = DataAges(spec.chains, world.clock)
        self._handlers = {e.timer.name: e.handler for e in self.model.timers}
        self._waiting: dict[str, int] = {}
        self._is_changing = False
        self._due_at = inf
        start = self.model.start if container.is_new else self.model.start_later
        process.after(drawn(world.choices, start), self._configured)

    @property
    def is_busy(self) -> bool:
        """Whether a handler runs."""
        return self.turn is not None

    def aim(self, goal: Goal) -> None:
        """Set the goal, which ends a migration that pauses it."""
        if self.goal == "finalized":
            return
        self.goal, self.is_in_migration = goal, False
        if goal == "active" and self.is_paused:
            self.resume()
        self._go_on()

    def stay(self) -> None:
        """Be as it is; `inactive` when it is new."""
        self.is_in_migration = True

    def pause(self) -> None:
        """Start no handler from now on."""
        if not self.is_paused:
            self.is_paused = True
            if self.state == "active":
                self.timers.stop(self._now)

    def resume(self) -> None:
        """Work again."""
        if self.is_paused:
            self.is_paused = False
            if self.state == "active":
                self._start_timers()
        self._go_on()

    def is_working(self) -> bool:
        """Return whether it may start a handler."""
        return (
            self.state == "active"
            and self.goal in {"active", "ready"}
            and not self.is_paused
            and self.container.may_work(self.spec)
        )

    def take(self, item: Incoming) -> None:
        """Take a message or a call; the oldest message of its connector makes room."""
        self.asked += 1
        slot = item.slot
        waiting = self._waiting.get(slot, 0)
        if item.answer is None:
            if waiting >= self.model.keep.get(slot, MOST_KEPT):
                self._drop_oldest(slot)
                waiting -= 1
            self._waiting[slot] = waiting + 1
        self.mailbox.append(item)
        self._work()

    def hand_over(self) -> list[Incoming]:
        """Give away all that waits."""
        items, self._waiting = list(self.mailbox), {}
        self.mailbox.clear()
        return items

    def take_over(self, items: list[Incoming]) -> None:
        """Have what waited for another incarnation, before all that came since."""
        self.mailbox.extendleft(reversed(items))
        for item in items:
            if item.answer is None:
                self._waiting[item.slot] = self._waiting.get(item.slot, 0) + 1

    def end_turn(self) -> None:
        """Take note that the handler has ended; begin the next one."""
        self.turn = None
        self.done += 1
        container = self.container
        container.look_again()
        container.report_missed(self)
        self._go_on()

    def status(self) -> ComponentStatus:
        """Return what its container reports of it, or reported last."""
        now = min(self._now, self.container.process.died_at)
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state=self.state,
            cpu=self.cpu,
            timers=self.timers.status(now),
            chains=self.ages.status() if self.ages else (),
        )

    def _drop_oldest(self, slot: str) -> None:
        for index, each in enumerate(self.mailbox):
            if each.slot == slot and each.answer is None:
                del self.mailbox[index]
                self.drops += 1
                self.container.world.ledger.dropped += 1
                return

    def _configured(self) -> None:
        self._enter("inactive")

    def _enter(self, state: State) -> None:
        was, self.state, self._is_changing = self.state, state, False
        if state == "active" and not self.is_paused:
            self._start_timers()
        elif was == "active":
            self.timers.stop(self._now)
        self._go_on()
        self.container.note_change()

    def _start_timers(self) -> None:
        self.timers.start(self._now)
        self._plan()

    def _go_on(self) -> None:
        """Take the next step of the life cycle, or work."""
        if self.state == "active" and self.goal in {"active", "ready"}:
            self._work()
            return
        steps: dict[tuple[State, Goal], State] = {
            ("inactive", "ready"): "active",
            ("inactive", "active"): "active",
            ("active", "inactive"): "inactive",
            ("active", "finalized"): "inactive",
            ("inactive", "finalized"): "finalized",
        }
        state = steps.get((self.state, self.goal))
        if state is not None and not self._is_changing and not self.is_busy:
            self._is_changing = True
            pause = drawn(self.container.world.choices, (0.0, self.model.activate))
            self.container.process.after(pause, lambda: self._enter(state))

    def _plan(self) -> None:
        """Look again when a timer is due."""
        due = self.timers.next_due()
        if due is None or due == self._due_at:
            return
        self._due_at = due
        self.container.process.after(
            max(0.0, due - self._now), lambda: self._on_due(due)
        )

    def _on_due(self, due: float) -> None:
        if due != self._due_at:
            return
        self._due_at = inf
        if not self.is_busy:
            self._work()
        if not self.is_busy and self.is_working():
            self._plan()

    def _work(self) -> None:
        """Let the next handler run, if one is due or a message waits."""
        if self.turn is not None or not self.is_working():
            return
        now = self._now
        for releases in self.timers:
            if releases.due <= now:
                self._run_timer(releases.timer, releases.begin(now), releases.end)
                return
        self._plan()
        if self.mailbox:
            item = self.mailbox.popleft()
            if item.answer is None:
                self._waiting[item.slot] -= 1
                handler = self.model.takes.get(item.slot, self.model.other)
            else:
                handler = self.model.serves.get(item.slot, self.model.other)
            self.turn = Turn(self, item.slot, handler, item)
            self.turn.begin()

    def _run_timer(
        self, timer: Timer, release: float, end: Callable[[float, float, float], None]
    ) -> None:
        began = self._now
        self.asked += 1
        self.turn = Turn(self, timer.name, self._handlers[timer.name])
        self.turn.then = lambda: end(release, began, self._now)
        self.turn.begin()

    @property
    def _now(self) -> float:
        return self.container.world.scheduler.now
