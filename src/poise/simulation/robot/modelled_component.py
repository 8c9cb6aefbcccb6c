"""A modelled component: its life cycle, and the steps of a migration in real phases.

`poise.wire.records.migration_records.STEPS` says what each step is for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from poise.errors import RunError
from poise.runtime.migration.step_taker import StepTaker
from poise.simulation._engine import ExecutorState, Sender
from poise.simulation.component_models import drawn
from poise.wire.records.deployment_records import ComponentSpec, LifeCycleGoal
from poise.wire.records.migration_records import MigrationPhases, MigrationSteps, Step
from poise.wire.records.status_records import ActionEnd, ComponentStatus, State

if TYPE_CHECKING:
    from poise.simulation.robot.modelled_container import SimulatedContainer


_CRASH_AFTER, _END_AFTER = (0.0, 4.0), (1.0, 15.0)
_FAILED = 0.3
"""How often an action fails by what its component says."""


class SimulatedComponent:
    """An incarnation in a container.

    `executor`: runs its handlers: its mailbox, its timers, its calls.
    """

    def __init__(self, container: SimulatedContainer, spec: ComponentSpec) -> None:
        world, process = container.world, container.process
        self.spec = spec
        self.model = world.model_of(spec.name)
        self.key = spec.key
        self.container = container
        self.state: State = "unconfigured"
        self.goal: LifeCycleGoal = "inactive"
        self.executor = container.execution.add(
            self.key,
            process.pid,
            world.engine_model_of(spec.name),
            [(chain.name, chain.is_first, chain.deadline) for chain in spec.chains],
        )
        self.executor.set_leased(spec.leased)
        self._is_changing = False
        self._error = ""
        self._ends = 0
        self._is_done = True
        self._has_worked = False
        start = self.model.start if container.is_new else self.model.start_later
        process.after(drawn(world.choices, start), self._be_configured)

    def deploy(self, spec: ComponentSpec) -> None:
        """Be as a deployment says."""
        self.spec = spec
        self.executor.set_leased(spec.leased)
        if spec.goal != "stay":
            self.aim(spec.goal)

    def aim(self, goal: LifeCycleGoal) -> None:
        """Set the goal, which ends a migration that pauses it."""
        if self.goal == "finalized":
            return
        self.goal = goal
        self.executor.set_wanted(goal in {"active", "ready"})
        if goal != "finalized":
            self.executor.set_idle(goal == "inactive" and self._has_worked)
        if goal == "active":
            self._has_worked = True
            self.container.migration.give_back(self)
            self.executor.resume()
        self._go_on()

    @property
    def is_at_work(self) -> bool:
        """Whether it is active, and is to be."""
        return self.state == "active" and self.goal == "active"

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
            error=self._error,
            ends=tuple(
                ActionEnd(port=port, count=self._ends, done=self._is_done)
                for port in self.model.ends
            ),
        )

    def _be_configured(self) -> None:
        """Be ready, unless its code fails now; some crashes its container later."""
        world, process = self.container.world, self.container.process
        flaw = world.workload.flaws.get(self.spec.implementation)
        if flaw == "fails":
            self._error = f"{self.spec.implementation} cannot be configured"
        if flaw == "crashes":
            process.after(drawn(world.choices, _CRASH_AFTER), self._crash)
        self._enter("failed" if self._error else "inactive")
        if self.model.ends:
            self._end_later()

    def _crash(self) -> None:
        """End the container, unless it is gone from there, or the code was mended."""
        container = self.container
        is_there = container.components.get(self.key) is self
        if is_there and self.spec.implementation in container.world.workload.flaws:
            container.process.kill()

    def _end_later(self) -> None:
        """Say now and then that an action is over."""
        world = self.container.world

        def end() -> None:
            if self.is_at_work:
                self._ends += 1
                self._is_done = not world.choices.happens("components", _FAILED)
                self.container.note_change()
            if self.state != "finalized":
                self._end_later()

        self.container.process.after(drawn(world.choices, _END_AFTER), end)

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
        steps: dict[tuple[State, LifeCycleGoal], State] = {
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


_POLL_EVERY = 0.002


class MigrationModel(StepTaker):
    """The steps of one container.

    `states`: component, epoch and migration -> what sources here have sent.
    """

    def __init__(self, container: SimulatedContainer) -> None:
        super().__init__(lambda: container.world.scheduler.now)
        self._container = container
        self._phases: dict[tuple[str, int], tuple[int, MigrationPhases]] = {}
        self.states: dict[tuple[str, int, int], ExecutorState] = {}
        self._sources: dict[tuple[str, int], int] = {}  # key -> source's epoch

    def give_back(self, component: SimulatedComponent) -> None:
        """Let a source go on with all that waited for it: the real one keeps it."""
        for key in [key for key in self.states if key[:2] == component.key]:
            component.executor.take_back(self.states.pop(key))

    def hear(self, batch: MigrationSteps) -> None:
        """Take steps on a task of their own, and answer; `halt` at once."""
        container = self._container
        if batch.steps and batch.steps[0].name == "halt":
            container.answer(self.halt(batch))
            return
        container.world.on_moment("steps", container.process.computer.name)
        take = self.receive(batch)
        container.process.spawn(
            f"steps {batch.number % 1000}", lambda: container.answer(take())
        )

    def _carry_out(self, step: Step, migration: int, deadline: float) -> None:
        container = self._container
        match step.name:
            case "buffer":
                for name in step.connectors:
                    sender = self._sender(name)
                    sender.buffer()
                    sender.mark(migration)
            case "release to targets" | "release to sources":
                for key in step.keys:
                    spec = container.connector(key)
                    connector = container.world.connector_of(spec)
                    self._sender(spec.name).redirect(connector)
            case "drain channels":
                receiver = self._component(step)
                container.wait(
                    lambda: all(
                        receiver.executor.marker(name) == migration
                        for name in step.connectors
                    ),
                    deadline,
                    f"markers over {', '.join(step.connectors)}: messages are still "
                    "under way",
                )
        if step.role is None:
            return
        component = self._component(step)
        with self._phases_of(component, step, migration).taking(step.name, step.phase):
            if step.role == "source":
                self._carry_out_at_source(component, step, migration, deadline)
            else:
                self._carry_out_at_target(component, step, migration, deadline)

    def _carry_out_at_source(
        self, component: SimulatedComponent, step: Step, migration: int, deadline: float
    ) -> None:
        container, key, executor = self._container, component.key, component.executor
        match step.name:
            case "await idle":
                until = min(deadline, self._now() + step.limit)
                while executor.is_busy and self._now() < until:
                    container.world.scheduler.wait(_POLL_EVERY, "an idle component")
            case "pause":
                executor.pause()
                container.wait(lambda: not executor.is_busy, deadline, "its handler")
                for sender in container.execution.senders_of(key):
                    sender.mark(migration)
            case "send state":
                self.states[*key, migration] = executor.hand_over()
            case "roll back":
                self.give_back(component)
                component.resume()

    def _carry_out_at_target(
        self, component: SimulatedComponent, step: Step, migration: int, deadline: float
    ) -> None:
        match step.name:
            case "pre-copy":
                # of what has another's place, no source has the state
                if source := step.sources.get(component.spec.name):
                    self._sources[component.key] = source[0]
            case "restore state" if component.key in self._sources:
                self._restore(component, migration, deadline)
            case "activate":
                component.executor.pause()
                component.aim("ready")
                self._container.wait(
                    lambda: component.state == "active", deadline, "`activate`"
                )
            case "resume":
                component.aim("active")

    def _restore(
        self, component: SimulatedComponent, migration: int, deadline: float
    ) -> None:
        """Wait until the source has sent its state, and take it."""
        container, world = self._container, self._container.world
        name, here = component.spec.name, container.process.computer.name
        epoch = self._sources[component.key]
        source = self._container_of(name, epoch)
        if source is None:
            raise RunError(f"no source of '{name}' is reached")
        there = source.process.computer.name
        states = source.migration.states
        seconds = drawn(world.choices, (0.0, 0.005))
        seconds += world.network.engine.time_for(
            there, here, component.model.state_size
        )

        def is_there() -> bool:
            if world.network.is_cut(there, here) or source.process.is_paused:
                return False
            return (name, epoch, migration) in states

        while not is_there():
            if self._now() >= deadline or source.process.is_dead:
                raise RunError(f"the state of '{name}' did not come from '{there}'")
            world.scheduler.wait(_POLL_EVERY, "a state")
        state = states[name, epoch, migration]
        world.scheduler.wait(seconds, "a state's transfer")
        component.executor.restore(state)

    def _container_of(self, name: str, epoch: int) -> SimulatedContainer | None:
        """Return where an incarnation is; None: it has ended."""
        for container in self._container.world.containers():
            found = container.components.get((name, epoch))
            if found is not None and found.state != "finalized":
                return container
        return None

    def _component(self, step: Step) -> SimulatedComponent:
        try:
            return self._container.components[step.component, step.epoch]
        except KeyError:
            text = f"component '{step.component}' ({step.epoch}) does not run here"
            raise RunError(text) from None

    def _sender(self, name: str) -> Sender:
        for sender in self._container.senders.values():
            if sender.connector.name == name:
                return sender
        container = self._container.name
        raise RunError(f"no connector '{name}' begins in container '{container}'")

    def _phases_of(
        self, component: SimulatedComponent, step: Step, migration: int
    ) -> MigrationPhases:
        key = component.key
        number, phases = self._phases.get(key, (-1, None))
        if phases is None or number < migration:
            assert step.role is not None  # noqa: S101, asked before
            phases = MigrationPhases(step.role, f"migration of component '{key[0]}'")
            self._phases[key] = migration, phases
        elif number > migration:
            raise RunError(f"component '{key[0]}': a later migration has begun")
        return phases
