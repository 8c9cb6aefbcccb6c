"""Watches a simulated robot, and keeps what a user wants to know of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from poise.manage.deploy.desired import Desired
from poise.manage.journal import JournalEntry
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.tasks.task_reports import OVER, TaskReport
from poise.model.robot import Robot
from poise.simulation.predicted_times import mean_of
from poise.simulation.robot.simulated_process import SimulatedComputer
from poise.simulation.robot.simulated_robot import SimulatedRobot
from poise.simulation.simulation_report import (
    Outage,
    SimulatedChain,
    SimulatedEvent,
    SimulatedLoad,
    SimulatedMove,
    TimerMisses,
)
from poise.wire.records.status_records import Summary, TimerStatus

SAMPLE_EVERY = 0.05
"""What works is looked at so often [s]; outages are known to that."""
_SECOND = 1.0
_POINTS = 600
"""A computer's load over time has at most this many points."""
_MOST_EVENTS = 5000
_KINDS = {"seen", "decided", "done", "failed", "wrong", "right"}


class SimulationObserver:
    """Looks at a robot from when it is up; moments count from then.

    `events`: what was injected and journalled.
    """

    def __init__(self, robot: SimulatedRobot) -> None:
        self.events: list[SimulatedEvent] = []
        self._robot = robot
        self._begin = robot.scheduler.now
        self._loads = {name: _LoadSeries() for name in robot.computers}
        self._second = 0.0
        self._down: dict[str, float] = {}
        self._since: dict[str, tuple[float, set[str]]] = {}
        self._outages: list[Outage] = []
        self._moves: list[SimulatedMove] = []
        self._restarting: dict[str, tuple[float, str]] = {}
        self._desired = self._wanted()
        self._placed = self._desired.placement() if self._desired else {}
        self._functions = functions_of(robot.robot)
        self._before = {
            id(c): {t.name: (t.releases, t.missed) for t in c.status().timers}
            for c in robot.components
        }
        self._chains_before = {
            id(component): {
                c.name: (c.age.count, c.missed) for c in component.status().chains
            }
            for component in robot.components
        }
        robot.on_entry = self._note_entry
        self._sample()

    @property
    def now(self) -> float:
        """Virtual time since the robot was up [s]."""
        return self._robot.scheduler.now - self._begin

    def note(self, who: str, kind: str, what: str) -> None:
        """Keep an event."""
        if len(self.events) > _MOST_EVENTS:
            return
        if len(self.events) == _MOST_EVENTS:
            kind, what = "wrong", f"after {_MOST_EVENTS} events no more are kept"
        self.events.append(SimulatedEvent(at=self.now, who=who, kind=kind, what=what))

    def loads(self) -> tuple[SimulatedLoad, ...]:
        """Return how busy each computer was."""
        if self.now >= self._second - SAMPLE_EVERY:  # it is over but for rounding
            self._second += _SECOND
            self._note_loads()
        loads = []
        for name, computer in self._robot.computers.items():
            cores, series = computer.cpu.cores, self._loads[name]
            mean = series.mean(self.now, self._used(computer))
            known = self._robot.robot.computer(name)
            loads.append(
                SimulatedLoad(
                    computer=name,
                    capacity=cores,
                    cpu=mean,
                    peak=max(series.peak, mean),
                    memory=series.memory,
                    memory_capacity=known.capacity.get("memory"),
                    over_time=series.points(),
                )
            )
        return tuple(loads)

    def tasks(self) -> tuple[TaskReport, ...]:
        """Return how the robot's tasks went, if its manager is up."""
        simulated = self._robot.manager
        manager = None if simulated is None else simulated.manager
        return () if manager is None else manager.tasks.reports

    def timers(self) -> tuple[TimerMisses, ...]:
        """Return how all timers kept their rates, over all incarnations."""
        first: dict[tuple[str, str], TimerStatus] = {}
        due, missed = Counter[tuple[str, str]](), Counter[tuple[str, str]]()
        for component in self._robot.components:
            before = self._before.get(id(component), {})
            for timer in component.status().timers:
                key = component.spec.name, timer.name
                due_before, missed_before = before.get(timer.name, (0, 0))
                first.setdefault(key, timer)
                due[key] += timer.releases - due_before
                missed[key] += timer.missed - missed_before
        return tuple(
            TimerMisses(
                component=key[0],
                timer=key[1],
                period=first[key].period,
                deadline=first[key].deadline,
                due=due[key],
                missed=missed[key],
            )
            for key in sorted(first)
        )

    def chains(self) -> tuple[SimulatedChain, ...]:
        """Return how old the data at the end of each chain was."""
        chains = []
        for chain in self._robot.robot.chains:
            ages: list[Summary] = []
            missed = 0
            for component in self._robot.components:
                if component.spec.name != chain.through[-1]:
                    continue
                before = self._chains_before.get(id(component), {})
                for status in component.status().chains:
                    if status.name == chain.name and status.age.count:
                        ages.append(status.age)
                        missed += status.missed - before.get(status.name, (0, 0))[1]
            age = mean_of(ages)
            if age.count:
                chains.append(
                    SimulatedChain(
                        name=chain.name,
                        deadline=chain.deadline,
                        uses=age.count,
                        missed=missed,
                        median=age.median,
                        p99=age.p99,
                        maximum=age.maximum,
                    )
                )
        return tuple(chains)

    def moves(self) -> tuple[SimulatedMove, ...]:
        """Return what was moved or restarted elsewhere."""
        return tuple(sorted(self._moves, key=lambda move: move.at))

    def outages(self) -> tuple[Outage, ...]:
        """Return which functions stopped, and for how long."""
        going = (self._outage(function, over=False) for function in sorted(self._since))
        return tuple(sorted((*self._outages, *going), key=lambda event: event.at))

    def _sample(self) -> None:
        scheduler = self._robot.scheduler
        self._note_placement()
        self._note_outages()
        if self.now >= self._second:
            self._second += _SECOND
            self._note_loads()
        scheduler.at(scheduler.now + SAMPLE_EVERY, self._sample)

    def _note_loads(self) -> None:
        memory = dict.fromkeys(self._robot.computers, 0.0)
        for container in self._robot.containers():
            at = container.process.computer.name
            memory[at] += sum(c.model.memory for c in container.components.values())
        for name, computer in self._robot.computers.items():
            self._loads[name].add(self.now, self._used(computer), memory[name])

    def _used(self, computer: SimulatedComputer) -> float:
        """Return what was used of a computer so far [s of all of it]."""
        cpu = computer.cpu
        return float(cpu.used() / (cpu.cores * cpu.speed))

    def _wanted(self) -> Desired | None:
        manager = self._robot.manager
        if manager is None or manager.live is None or manager.manager is None:
            return None
        return manager.live.desired

    def _note_placement(self) -> None:
        """Note what is placed elsewhere, though no move brought it there.

        And what is not placed because no task needs it any more.
        """
        desired = self._wanted()
        if desired is None or desired is self._desired:
            return
        self._desired, placed = desired, desired.placement()
        for name, at in placed.items():
            before = self._placed.get(name)
            if before is not None and before != at:
                since = self._down.get(name, self._robot.scheduler.now)
                self._restarting[name] = since - self._begin, before
        self._placed.update(placed)
        for name in self._placed.keys() - placed.keys() - self._needed(placed):
            del self._placed[name]
            self._down.pop(name, None)
            self._restarting.pop(name, None)

    def _needed(self, placed: Mapping[str, str]) -> set[str]:
        """Return the components of what a task that is not over uses now.

        And those of layers that never stop; but not of an architecture in whose place
        an alternative runs.
        """
        robot, manager = self._robot.robot, self._robot.manager
        assert manager is not None  # noqa: S101, it has told what is placed
        assert manager.manager is not None  # noqa: S101, the same
        tasks = manager.manager.tasks.tasks
        used = tasks.functions_of(r for r in tasks.records if r.state not in OVER)
        provided = {
            architecture.function: architecture.name
            for architecture in robot.architectures
            if any(component.name in placed for component in architecture.components)
        }
        return {
            component.name
            for architecture in robot.architectures
            if provided.get(architecture.function) in {None, architecture.name}
            if architecture.layer != "sequencing" or architecture.function in used
            for component in architecture.components
        }

    def _note_outages(self) -> None:
        now = self._robot.scheduler.now
        working = {name for name, _ in self._robot.working()}
        is_calm = not (self._down or self._since or self._restarting)
        if is_calm and working >= self._placed.keys():
            return
        for name in self._placed:
            if name in working:
                self._down.pop(name, None)
                if name in self._restarting:
                    self._end_restart(name)
            else:
                self._down.setdefault(name, now)
        for function, names in self._functions.items():
            down = names & self._down.keys() & self._placed.keys()
            if down:
                self._since.setdefault(function, (self.now, set()))[1].update(down)
            elif function in self._since:
                self._outages.append(self._outage(function, over=True))
                del self._since[function]

    def _outage(self, function: str, *, over: bool) -> Outage:
        since, names = self._since[function]
        return Outage(
            at=since,
            function=function,
            components=tuple(sorted(names)),
            lasts=self.now - since,
            over=over,
        )

    def _end_restart(self, name: str) -> None:
        at, before = self._restarting.pop(name)
        after = self._placed[name]
        if before == after:
            return
        self._moves.append(
            SimulatedMove(
                at=at,
                component=name,
                before=before,
                after=after,
                kind="restart",
                downtime=self.now - at,
            )
        )

    def _forget_restart(self, name: str, after: str) -> None:
        """Take back what only seemed a restart: a move had not been journalled yet."""
        self._restarting.pop(name, None)
        last = next((m for m in reversed(self._moves) if m.component == name), None)
        if last is not None and (last.kind, last.after) == ("restart", after):
            self._moves.remove(last)

    def _note_entry(self, entry: JournalEntry) -> None:
        facts: Mapping[str, object] = entry.facts or {}
        migration = facts.get("migration")
        if isinstance(migration, MigrationReport) and migration.committed:
            for name, after in migration.after.items():
                before = migration.before.get(name, "")
                if before == after:
                    continue
                self._placed[name] = after
                self._forget_restart(name, after)
                self._moves.append(
                    SimulatedMove(
                        at=self.now,
                        component=name,
                        before=before,
                        after=after,
                        kind="move",
                        downtime=migration.downtime,
                        why=entry.what,
                    )
                )
        if entry.kind in _KINDS:
            self.note("manager", entry.kind, entry.what)


class _LoadSeries:
    """The shares of a computer's CPU, each second."""

    def __init__(self) -> None:
        self.peak = self.memory = 0.0
        self._first: tuple[float, float] | None = None
        self._last = 0.0, 0.0
        self._points: list[tuple[float, float]] = []

    def add(self, at: float, used: float, memory: float) -> None:
        """Add what was used until a moment [s of the whole computer]."""
        if self._first is None:
            self._first = at, used
        else:
            before, total = self._last
            share = (used - total) / (at - before)
            self.peak = max(self.peak, share)
            self._points.append((at, share))
        self._last = at, used
        self.memory = max(self.memory, memory)

    def mean(self, at: float, used: float) -> float:
        """Return the mean share until a moment [s]; `used` as for `add`."""
        began, before = self._first or (at, used)
        return (used - before) / (at - began) if at > began else 0.0

    def points(self) -> tuple[tuple[float, float], ...]:
        """Return moments [s], and the mean share since the one before."""
        step = max(1, -(-len(self._points) // _POINTS))
        parts = (self._points[i : i + step] for i in range(0, len(self._points), step))
        return tuple(
            (part[-1][0], sum(share for _, share in part) / len(part)) for part in parts
        )


def functions_of(robot: Robot) -> dict[str, set[str]]:
    """Return function -> the components of all architectures that provide it."""
    functions: dict[str, set[str]] = {}
    for architecture in robot.architectures:
        names = {component.name for component in architecture.components}
        functions.setdefault(architecture.function, set()).update(names)
    return functions
