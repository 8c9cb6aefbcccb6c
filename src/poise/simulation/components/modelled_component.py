"""One incarnation of a modelled component: its life cycle; the engine lets it work."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from poise.simulation.components.models import drawn
from poise.wire.records.deployment_records import ComponentSpec
from poise.wire.records.status_records import ComponentStatus, State

if TYPE_CHECKING:
    from poise.simulation.components.modelled_container import SimulatedContainer

Goal = Literal["inactive", "ready", "active", "finalized"]


class SimulatedComponent:
    """An incarnation in a container.

    `executor`: runs its handlers: its mailbox, its timers, its calls.
    """

    def __init__(self, container: SimulatedContainer, spec: ComponentSpec) -> None:
        world, process = container.world, container.process
        self.spec = spec
        self.model = world.model_of(spec.name)
        self.key = spec.name, spec.epoch
        self.container = container
        self.state: State = "unconfigured"
        self.goal: Goal = "inactive"
        self.executor = container.execution.add(
            self.key,
            process.pid,
            world.engine_model_of(spec.name),
            [(each.name, each.is_first, each.deadline) for each in spec.chains],
        )
        self.executor.set_leased(spec.leased)
        self._is_changing = False
        start = self.model.start if container.is_new else self.model.start_later
        process.after(drawn(world.choices, start), self._configured)

    def deploy(self, spec: ComponentSpec) -> None:
        """Be as a deployment says."""
        self.spec = spec
        self.executor.set_leased(spec.leased)
        if spec.goal != "stay":
            self.aim(spec.goal)

    def aim(self, goal: Goal) -> None:
        """Set the goal, which ends a migration that pauses it."""
        if self.goal == "finalized":
            return
        self.goal = goal
        self.executor.set_wanted(goal in {"active", "ready"})
        if goal == "active":
            self.container.migration.give_back(self)
            self.executor.resume()
        self._go_on()

    def resume(self) -> None:
        """Work again."""
        self.executor.resume()
        self._go_on()

    def status(self) -> ComponentStatus:
        """Return what its container reports of it, or reported last."""
        now = min(self.container.world.scheduler.now, self.container.process.died_at)
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state=self.state,
            cpu=self.executor.cpu,
            timers=self.executor.timers(now),
            chains=self.executor.chains(),
        )

    def _configured(self) -> None:
        self._enter("inactive")

    def _enter(self, state: State) -> None:
        was, self.state, self._is_changing = self.state, state, False
        if state == "active":
            self.executor.activate()
        elif was == "active":
            self.executor.deactivate()
        self._go_on()
        self.container.note_change()

    def _go_on(self) -> None:
        """Take the next step of the life cycle, or work."""
        if self.state == "active" and self.goal in {"active", "ready"}:
            self.executor.work()
            return
        steps: dict[tuple[State, Goal], State] = {
            ("inactive", "ready"): "active",
            ("inactive", "active"): "active",
            ("active", "inactive"): "inactive",
            ("active", "finalized"): "inactive",
            ("inactive", "finalized"): "finalized",
        }
        state = steps.get((self.state, self.goal))
        if state is None or self._is_changing:
            return
        if self.executor.is_busy:
            self.executor.when_idle(self._go_on)
            return
        self._is_changing = True
        pause = drawn(self.container.world.choices, (0.0, self.model.activate))
        self.container.process.after(pause, lambda: self._enter(state))
