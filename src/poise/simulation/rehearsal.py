"""A robot in virtual time, for a user who asks what will happen."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from msgspec import structs

from poise.errors import RunError
from poise.estimate.profiles import ConnectorProfile
from poise.manage.control_socket.commands import MoveCommand, Refusal, Result
from poise.manage.migration.migration_report import MigrationReport
from poise.model.steps import Action, steps_of
from poise.simulation.choices import Choices
from poise.simulation.faults import SimulatedFault, inject
from poise.simulation.robot.simulated_robot import OUTSIDE, ManagedRobot, SimulatedRobot
from poise.simulation.scheduler import SimulationError
from poise.simulation.simulation_observer import SimulationObserver
from poise.simulation.simulation_report import SimulationReport
from poise.simulation.workload import workload_of


def unsettled(robot: SimulatedRobot) -> list[str]:
    """Return what is not as it is desired, in words."""
    manager = robot.manager
    if manager is None or manager.manager is None or manager.live is None:
        why = robot.managers[-1].error if robot.managers else None
        return [f"no manager is up ({why or 'it starts'})"]
    working: dict[str, list[str]] = {}
    for name, at in robot.working():
        working.setdefault(name, []).append(at)
    misplaced = [
        f"'{name}' works on {' and '.join(working.get(name, ['nothing']))}, not '{at}'"
        for name, at in sorted(manager.live.placement().items())
        if working.get(name) != [at]
    ]
    lost = sorted(manager.manager.lost.computers())
    return misplaced + [f"the manager considers '{name}' lost" for name in lost]


UP_LIMIT = 60.0
"""A robot that is not up within this time [virtual s] does not come up."""
MOVE_LIMIT = 60.0
"""A move ends within this time [virtual s]."""
_POLL_EVERY = 0.1
_MOVE_EVERY = 0.005


class RehearsalPlan(ManagedRobot, frozen=True, kw_only=True):
    """What is simulated, but for the seed.

    `method`: what decided the placement.
    `faults`: what breaks; `at` counts from the moment when the robot is up [s].
    `cores`: component -> what it takes in each second, again and again [cores of the
    reference]; of the others the profile's mean counts.
    `bag`: connector from a bridge -> how often and how large messages come over it.
    `seconds`: how long it is to last [virtual s].
    """

    method: str
    faults: tuple[SimulatedFault, ...] = ()
    cores: Mapping[str, tuple[float, ...]] = {}
    bag: Mapping[str, ConnectorProfile] = {}
    seconds: float = 60.0


def _without_code(plan: RehearsalPlan) -> Iterator[str]:
    """Yield what the user's code would decide on the robot."""
    for policy in plan.robot.policies:
        if policy.call and not policy.off:
            yield f"'{policy.call}' of policy '{policy.name}' is not asked here"
    tasks = {task.name: task for task in plan.robot.tasks}
    steps = (step for name in plan.tasks for step in steps_of(tasks, name))
    names = dict.fromkeys(
        f"'{s.name}'" for s in steps if isinstance(s, Action) and s.ends is not None
    )
    if names:
        yield (
            f"no component says that {' or '.join(names)} is done, as no code runs: "
            "such an action goes on until its limit, and then fails"
        )


class Rehearsal:
    """A simulated robot that comes up, goes on as long as it is let, and is looked at.

    The manager of a robot whose computers are all emulated runs outside of these, as
    `poise up` runs it; else it runs on the first computer.
    """

    def __init__(self, plan: RehearsalPlan, seed: int = 0) -> None:
        self._plan = plan
        self._seed = seed
        self._work = workload_of(plan.robot, plan.profile, plan.cores, plan.bag)
        policies = tuple(p for p in plan.robot.policies if not p.call)
        robot = structs.replace(plan.robot, policies=policies)
        managed = structs.replace(plan, robot=robot)
        self._robot = SimulatedRobot(managed, Choices(seed), self._work)
        self._observer: SimulationObserver | None = None
        self._took = 0.0
        self._violations: list[str] = []

    @property
    def now(self) -> float:
        """Virtual time since the robot was up [s]."""
        return self._observer.now if self._observer else 0.0

    def come_up(self) -> None:
        """Start the robot.

        Raises RunError: it is not up within `UP_LIMIT`, or a defect of Poise ended it.
        """
        robot = self._robot
        with self._running():
            for computer in robot.computers:
                robot.start_agent(computer)
            is_real = any(computer.address for computer in robot.robot.computers)
            robot.start_manager(next(iter(robot.computers)) if is_real else OUTSIDE)
            while wrong := unsettled(robot):
                if robot.scheduler.now >= UP_LIMIT:
                    why = "; ".join(wrong)
                    raise RunError(f"the simulated robot does not come up: {why}")
                robot.run(robot.scheduler.now + _POLL_EVERY)
            self._observer = SimulationObserver(robot)
            for fault in self._plan.faults:
                at = robot.scheduler.now + fault.at
                robot.scheduler.at(at, partial(self._break, fault))
        if self._violations:
            why = "; ".join(self._violations)
            raise RunError(f"the simulated robot does not come up: {why}")

    def advance(self, seconds: float) -> None:
        """Let virtual time [s] pass."""
        with self._running():
            self._robot.run(self._robot.scheduler.now + seconds)

    def move(self, component: str, computer: str) -> MigrationReport:
        """Let a client move a component, whatever the planner thinks of it."""
        results: list[Result | Refusal] = []
        manager, robot = self._robot.manager, self._robot
        assert manager is not None, "it has to come up first"  # noqa: S101
        with self._running():
            manager.ask(MoveCommand(component, computer, force=True), results.append)
            until = robot.scheduler.now + MOVE_LIMIT
            while not results and robot.scheduler.now < until:
                robot.run(robot.scheduler.now + _MOVE_EVERY)
        result = results[0] if results else "it did not end"
        if not isinstance(result, MigrationReport) or not result.committed:
            raise RunError(f"'{component}' does not move to '{computer}': {result}")
        return result

    def report(self) -> SimulationReport:
        """Return what is known so far; any time after `come_up`."""
        observer, plan, ledger = self._observer, self._plan, self._robot.ledger
        assert observer is not None, "it has to come up first"  # noqa: S101
        wrong = (f"{name}: {what}" for name, what in ledger.violations)
        return SimulationReport(
            robot=plan.robot.name,
            task="+".join(plan.tasks),
            method=plan.method,
            seed=self._seed,
            adapts=plan.adapts,
            placement=plan.placement,
            asked=plan.seconds,
            seconds=observer.now,
            took=self._took,
            loads=observer.loads(),
            timers=observer.timers(),
            chains=observer.chains(),
            moves=observer.moves(),
            outages=observer.outages(),
            events=tuple(observer.events),
            messages=ledger.processed,
            dropped=ledger.dropped,
            calls=ledger.calls,
            failed_calls=ledger.failed_calls,
            tasks=observer.tasks(),
            guesses=(*_without_code(plan), *self._work.guesses),
            violations=tuple(dict.fromkeys((*self._violations, *wrong))),
        )

    def close(self) -> None:
        """End all that it simulates."""
        with self._robot.library:
            self._robot.end()

    def _break(self, fault: SimulatedFault) -> None:
        assert self._observer is not None  # noqa: S101, it has come up
        self._observer.note("fault", "fault", str(fault))
        inject(self._robot, fault)

    @contextmanager
    def _running(self) -> Iterator[None]:
        """Count the CPU time; an error in Poise's code is a violation."""
        began = time.process_time()
        gc.freeze()
        try:
            with self._robot.library:
                yield
        except SimulationError as error:
            self._violations.append(f"no-bug-stops-the-robot: {error}")
        finally:
            gc.unfreeze()
            self._took += time.process_time() - began
