"""A modelled container: it does what its agent says, as the real one answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from typing import TYPE_CHECKING, Literal

from poise.errors import RunError
from poise.simulation._engine import Sender
from poise.simulation.robot.modelled_component import MigrationModel, SimulatedComponent
from poise.simulation.robot.simulated_process import Process
from poise.simulation.scheduler import SimulatedTask
from poise.wire.codec import pack, unpack
from poise.wire.records.deployment_records import ConnectorSpec, ContainerSpec
from poise.wire.records.heartbeat_records import Clocks
from poise.wire.records.migration_records import MigrationSteps
from poise.wire.records.request_records import (
    PARAMETERS,
    PortAnswer,
    PortRequest,
    TapReading,
)
from poise.wire.records.status_records import (
    ConnectorStatus,
    ContainerStatus,
    FromContainer,
    Side,
    ToContainer,
)

if TYPE_CHECKING:
    from poise.simulation.robot.simulated_robot import SimulatedRobot

_MISSED_WITHIN = 0.1
"""A missed deadline is reported within this time [s]."""
REPORT_EVERY = 1.0
"""As the real container's [s]."""
_JOINING_EVERY = 0.02
_WEIGHT = 100.0
"""Of a container that is given none."""
ORPHAN_LIMIT, LEASED_ORPHAN_LIMIT = 60.0, 10.0
"""A container without an agent ends after this time [s]; with leased components, after
the shorter one."""
Key = tuple[str, int]
Moment = Literal["steps", "up", "paused", "command"]


class SimulatedContainer:
    """A container of one computer.

    `tell_agent`: sends its agent a record; None: it has no agent at the moment.
    `is_new`: whether it has had no component yet.
    `lease_end`: the end of the lease that its page shows [s, CLOCK_BOOTTIME].
    `execution`: what runs its components: one interpreter, so one core at most.
    `senders`: the slots of its components, with their epochs -> their sending ends.
    """

    def __init__(self, world: SimulatedRobot, process: Process, name: str) -> None:
        self.world = world
        self.process = process
        self.name = name
        self.tell_agent: Callable[[FromContainer], object] | None = None
        self.lease_end = 0.0  # as that of a page that its agent has not written to
        self.components: dict[Key, SimulatedComponent] = {}
        self.is_new = True
        self.senders: dict[str, Sender] = {}
        self._wanted: ContainerSpec | None = None
        self._connectors: Mapping[str, ConnectorSpec] = {}
        self.migration = MigrationModel(self)
        self._waiting: list[SimulatedTask] = []
        self._is_reporting = False
        self._reported: tuple[ConnectorStatus, ...] = ()
        self._orphan_since = inf
        self.execution = world.scheduler.engine.container(
            process.computer.cpu,
            process.computer.name,
            self.look_again,
            lambda: process.after(_MISSED_WITHIN, self._report),
        )
        self.extend_lease(self.lease_end)
        process.on_pause = self.execution.pause
        process.on_end.append(self.execution.end)

    def hear(self, record: ToContainer) -> None:
        """Take what its agent says; on a task or action of its process."""
        if isinstance(record, ContainerSpec):
            self.migration.note_deployment(record)
            self._wanted = record
            self.execution.cpu.weight = record.weight or _WEIGHT
            self._apply(record)
            self._report()
            self._report_later()
        elif isinstance(record, MigrationSteps):
            self.migration.hear(record)
        elif isinstance(record, PortRequest):
            self.answer(self._answer_to(record))
        elif not isinstance(record, Clocks):
            self.answer(
                TapReading(number=record.number, connector=record.connector, carries="")
            )

    def _answer_to(self, asked: PortRequest) -> PortAnswer:
        """Let a component take parameters; nothing else that it would answer."""
        if (asked.port, asked.method) != (PARAMETERS, "set"):
            why = "what a component would answer is not simulated"
            return PortAnswer(number=asked.number, outcome="refused", reason=why)
        working = {c.spec.name for c in self.components.values() if c.is_at_work}
        if asked.component not in working:
            why = f"'{asked.component}' does not work here"
            return PortAnswer(number=asked.number, outcome="away", reason=why)
        _, changes = unpack(asked.value)
        return PortAnswer(number=asked.number, outcome="done", value=pack(changes))

    def answer(self, record: FromContainer) -> None:
        """Tell the agent something; in vain when there is none."""
        if self.tell_agent is not None:
            self.tell_agent(record)

    def extend_lease(self, until: float) -> None:
        """Let leased components work until a moment [s, CLOCK_BOOTTIME]."""
        had_ended = self.lease_end <= self.process.computer.boottime()
        self.lease_end = until
        self.execution.set_lease_end(self.process.computer.moment_of(until))
        if had_ended:
            self.process.after(0.0, self._begin_due)

    def _begin_due(self) -> None:
        """Begin what was due while the lease had ended."""
        for component in self.components.values():
            component.executor.work()

    def note_change(self) -> None:
        """Report soon, and let steps that wait look again."""
        if not self._is_reporting:
            self._is_reporting = True
            self.process.after(0.0, self._report)
        self.look_again()

    def look_again(self) -> None:
        """Let steps that wait for something look whether it holds now."""
        waiting, self._waiting = self._waiting, []
        for task in waiting:
            self.world.scheduler.wake(task)

    def wait(self, holds: Callable[[], bool], deadline: float, what: str) -> None:
        """Let a task wait until something holds.

        Raises RunError: it did not until `deadline` [s].
        """
        scheduler = self.world.scheduler
        while not holds():
            left = deadline - scheduler.now
            if left <= 0:
                raise RunError(f"container '{self.name}': {what} took too long")
            task = scheduler.current
            assert task is not None  # noqa: S101, steps are tasks
            self._waiting.append(task)
            self.execution.await_progress()
            scheduler.wait(left, what)
            if task in self._waiting:
                self._waiting.remove(task)

    def connector(self, name_or_key: str) -> ConnectorSpec:
        """Return a connector of the present deployment, by its name or key."""
        for spec in self._connectors.values():
            if name_or_key in {spec.key, spec.name}:
                return spec
        raise RunError(f"container '{self.name}' has no connector '{name_or_key}'")

    def note_agent_gone(self) -> None:
        """Go on without an agent, for a limited time."""
        self.tell_agent = None
        since = self._orphan_since = self.world.scheduler.now
        components = self._wanted.components if self._wanted else ()
        is_leased = any(component.leased for component in components)
        limit = LEASED_ORPHAN_LIMIT if is_leased else ORPHAN_LIMIT

        def end() -> None:
            if self.tell_agent is None and self._orphan_since == since:
                self.process.kill()

        self.process.after(limit, end)

    def _apply(self, spec: ContainerSpec) -> None:
        wanted = {c.key: c for c in spec.components}
        self._connectors = {connector.key: connector for connector in spec.connectors}
        self.execution.connect(list(map(self.world.connector_of, spec.connectors)))
        self.is_new = not self.components
        for key, component in wanted.items():
            if key not in self.components:
                self.components[key] = SimulatedComponent(self, component)
                self.world.components.append(self.components[key])
        self._join(spec.connectors)
        for key, running in list(self.components.items()):
            if key not in wanted:
                running.aim("finalized")
                self._remove_later(key)
                continue
            running.deploy(wanted[key])

    def _join(self, connectors: tuple[ConnectorSpec, ...]) -> None:
        """Let each slot lead to one target; during a move it stays where it is."""
        slots: dict[str, list[ConnectorSpec]] = {}
        for spec in connectors:
            if (spec.source, spec.source_epoch) in self.components:
                key = f"{spec.slot or spec.name}/{spec.source_epoch}"
                slots.setdefault(key, []).append(spec)
        for key in sorted(self.senders.keys() - slots.keys()):
            self.execution.remove_sender(self.senders.pop(key))
        for key, choices in slots.items():
            sender = self.senders.get(key)
            connector = self.world.connector_of(choices[0])
            if sender is None:
                self.senders[key] = self.execution.add_sender(connector)
            elif len(choices) == 1 and (
                sender.is_buffering or sender.connector.key != connector.key
            ):
                sender.redirect(connector)

    def _remove_later(self, key: Key) -> None:
        """Forget a component once it has ended."""
        component = self.components.get(key)
        if component is None:
            return
        if component.state in {"finalized", "failed"}:
            self.execution.remove(self.components.pop(key).executor)
            if self._wanted is not None:
                self._apply(self._wanted)  # it may be wanted again by now
            self.note_change()
        else:
            self.process.after(0.002, lambda: self._remove_later(key))

    def _report_later(self) -> None:
        wanted = self._wanted

        def report() -> None:
            if self._wanted is wanted:
                self._report()
                self._report_later()

        self.process.after(REPORT_EVERY, report)

    def _report(self) -> None:
        self._is_reporting = False
        self.execution.await_missed()
        if self._wanted is None:
            return
        connectors = self._joined()
        self._reported = connectors
        if not all(connector.ready for connector in connectors):
            self.process.after(_JOINING_EVERY, lambda: self._report_joined(connectors))
        self.answer(
            ContainerStatus(
                name=self.name,
                pid=self.process.pid,
                at=self.process.computer.monotonic(),
                cpu=self.execution.cpu.used,
                components=tuple(c.status() for c in self.components.values()),
                connectors=connectors,
            )
        )

    def _joined(self) -> tuple[ConnectorStatus, ...]:
        statuses = []
        for spec in self._connectors.values():
            is_source = (spec.source, spec.source_epoch) in self.components
            end: Side = "source" if is_source else "target"
            statuses.append(
                ConnectorStatus(
                    name=spec.name,
                    kind=spec.kind,
                    end="both" if spec.kind == "direct" else end,
                    ready=self._is_joined(spec),
                )
            )
        return tuple(statuses)

    def _report_joined(self, before: tuple[ConnectorStatus, ...]) -> None:
        """Report when a connector is joined that was not; else look again."""
        if self._joined() != before:
            self.note_change()
        elif not self._is_reporting and self._reported == before:
            self.process.after(_JOINING_EVERY, lambda: self._report_joined(before))

    def _is_joined(self, spec: ConnectorSpec) -> bool:
        here = self.process.computer.name
        for computer, component, epoch in (
            (spec.source_computer, spec.source, spec.source_epoch),
            (spec.target_computer, spec.target, spec.target_epoch),
        ):
            at = computer or here
            if at == here and (component, epoch) in self.components:
                continue
            other = self.world.container_of(at, component, epoch)
            is_cut = at != here and (
                self.world.network.is_cut(at, here)
                or self.world.network.is_cut(here, at)
            )
            if other is None or is_cut:
                return False
        return True
