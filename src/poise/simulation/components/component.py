"""One incarnation of a modelled component: its life cycle, its work, its mailbox."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Literal

from poise.runtime.connectors.overtaken_sources import OvertakenSources
from poise.simulation.components.ledger import WorkingIncarnation
from poise.simulation.components.models import drawn
from poise.wire.records.deployment import ComponentSpec
from poise.wire.records.status import ComponentStatus, State, Summary, TimerStatus

if TYPE_CHECKING:
    from poise.simulation.components.container import SimulatedContainer

Goal = Literal["inactive", "ready", "active", "finalized"]


class SimulatedComponent:
    """An incarnation in a container.

    Attributes
    ----------
    is_paused
        Whether a migration lets it start nothing.
    is_busy
        Whether a handler runs.
    markers
        Connector -> the last migration whose marker came over it.
    """

    def __init__(self, container: SimulatedContainer, spec: ComponentSpec) -> None:
        self.spec = spec
        self.model = container.world.model_of(spec.name)
        process = container.process
        computer = process.computer.name
        self.who = WorkingIncarnation(spec.name, spec.epoch, computer, process.pid)
        self.state: State = "unconfigured"
        self.goal: Goal = "inactive"
        self.is_paused = False
        self.is_busy = False
        self.is_in_migration = False
        self.releases = self.missed = 0
        self.markers: dict[str, int] = {}
        self.overtaken = OvertakenSources()
        self.mailbox: deque[tuple[str, int]] = deque()
        self._container = container
        self._is_changing = False
        self._due = 0.0
        choices = container.world.choices
        container.process.after(drawn(choices, self.model.start), self._configured)

    def aim(self, goal: Goal) -> None:
        """Set the goal, which ends a migration that pauses it."""
        if self.goal == "finalized":
            return
        self.goal, self.is_in_migration = goal, False
        if goal == "active":
            self.is_paused = False
        self._go_on()

    def stay(self) -> None:
        """Be as it is; `inactive` when it is new."""
        self.is_in_migration = True

    def pause(self) -> None:
        """Start no handler from now on."""
        self.is_paused = True

    def resume(self) -> None:
        """Work again."""
        self.is_paused = False
        self._go_on()

    def is_working(self) -> bool:
        """Return whether it may start a handler."""
        return (
            self.state == "active"
            and self.goal in {"active", "ready"}
            and not self.is_paused
            and self._container.may_work(self.spec)
        )

    def take(self, connector: str, number: int) -> None:
        """Take a message; the oldest of its connector makes room."""
        waiting = [entry for entry in self.mailbox if entry[0] == connector]
        if len(waiting) >= self.model.keep:
            self.mailbox.remove(waiting[0])
        self.mailbox.append((connector, number))
        self._work()

    def status(self) -> ComponentStatus:
        """Return what its container reports of it."""
        timer = TimerStatus(
            name="tick",
            period=self.model.period,
            deadline=None,
            releases=self.releases,
            missed=self.missed,
            lateness=Summary(),
            duration=Summary(),
        )
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state=self.state,
            timers=(timer,) if self.model.period else (),
        )

    def _configured(self) -> None:
        self._enter("inactive")

    def _enter(self, state: State) -> None:
        self.state, self._is_changing = state, False
        if state == "active":
            self._due = self._now + self.model.period
            self._plan()
        self._go_on()
        self._container.note_change()

    def _go_on(self) -> None:
        """Take the next step of the life cycle, or work."""
        steps: dict[tuple[State, Goal], State] = {
            ("inactive", "ready"): "active",
            ("inactive", "active"): "active",
            ("active", "inactive"): "inactive",
            ("active", "finalized"): "inactive",
            ("inactive", "finalized"): "finalized",
        }
        state = steps.get((self.state, self.goal))
        if state is None:
            self._work()
        elif not self._is_changing and not self.is_busy:
            self._is_changing = True
            choices = self._container.world.choices
            pause = drawn(choices, (0.0, self.model.activate))
            self._container.process.after(pause, lambda: self._enter(state))

    def _plan(self) -> None:
        """Let the timer be due in time."""
        if self.model.period:
            self._container.process.after(
                max(0.0, self._due - self._now), self._release
            )

    def _release(self) -> None:
        if self.state != "active":
            return
        self._due += self.model.period
        if self._due <= self._now:  # it was paused, or its process
            late = int((self._now - self._due) / self.model.period) + 1
            self._due += late * self.model.period
            self.missed += late
        self.releases += 1
        self._plan()
        if self.is_working() and not self.is_busy:
            self._run(None)
        else:
            self.missed += 1

    def _work(self) -> None:
        """Handle a message, if one waits and nothing runs."""
        if self.mailbox and not self.is_busy and self.is_working():
            self._run(self.mailbox.popleft())

    def _run(self, message: tuple[str, int] | None) -> None:
        world = self._container.world
        self.is_busy = True
        world.ledger.begin(self.who, self._now)
        if message is not None:
            world.ledger.process(*message, self.who)
        work = drawn(world.choices, self.model.duration)
        self._container.cpu.run(work, lambda: self._end(message))

    def _end(self, message: tuple[str, int] | None) -> None:
        self.is_busy = False
        ledger = self._container.world.ledger
        ledger.end(self.who, self._container.process.awake_since, self._now)
        if message is None and self._container.may_work(self.spec):
            ledger.act(self.who, self._now)
            self._container.publish(self)
        self._container.look_again()
        self._go_on()

    @property
    def _now(self) -> float:
        return self._container.world.scheduler.now
