"""Simulates a task of a robot in virtual time, and compares placements so."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct, structs
from rich.console import RenderableType

from poise.errors import RobotError, RunError, UsageError
from poise.estimate.success_rates import as_learned
from poise.model.robot import Robot
from poise.session import Check, Say, log, nothing
from poise.session.arguments import check_duration, check_names, check_path, check_type
from poise.session.bag_workload import bag_traffic
from poise.session.fault_file import Faults, faults_of
from poise.session.placing.first_phase import first_phase
from poise.session.placing.placement import Placement, place
from poise.session.profiling.stored_profiles import read_profile
from poise.session.recorded_run import RecordedRun
from poise.session.render.printable import Printable
from poise.session.render.simulation_tables import (
    comparison_page,
    comparison_parts,
    ended_early,
    simulation_page,
    simulation_parts,
    simulation_picture,
    verdict,
)
from poise.session.robot_file import task_of
from poise.simulation.simulation_report import SimulationReport
from poise.wire.bag_file import is_bag


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Raise the KeyboardInterrupt of Ctrl-C at the end of the block, not inside it.

    Code that is simulated runs there: it would take the interrupt for an error of its
    own. A program that handles SIGINT itself keeps its handler.
    """
    is_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    if not is_main or before is not signal.default_int_handler:
        yield
        return
    came = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: came.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came.is_set():
        raise KeyboardInterrupt


if TYPE_CHECKING:
    from poise.simulation.rehearsal import Rehearsal, RehearsalPlan

Watch = Callable[[float], object]
"""Called a few times a second with the virtual time so far [s]."""
_STEP = 0.5
"""So much virtual time passes between two looks at whether it is to end [s]."""
_ROUNDING = 1e-6
"""What is left of the time, and is only what sums of times are wrong by [s]."""


def simulate(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    seconds: float = 60.0,
    placement: Placement | None = None,
    faults: Faults = (),
    seed: int = 0,
    adapt: bool = True,
    recording: str | PathLike[str] | None = None,
    say: Say = log.info,
    meanwhile: Watch = nothing,
    check: Check = nothing,
) -> Simulation:
    """Simulate a task in virtual time, with the robot's own manager and agents.

    Nothing is started, and no handler of a component runs. The same seed gives the same
    simulation. Ctrl-C (`KeyboardInterrupt`) ends it early, and the report has what is
    known by then; the same before the robot is up is raised.

    Parameters
    ----------
    task
        Its name; None: the robot's first.
    seconds
        How long, from the moment when the robot is up [virtual s].
    placement
        What `poise.place` decided; None: it is decided here.
    faults
        What breaks; or a file with it; or ``random``: the seed picks.
    seed
        Of chance in what is simulated, and of random faults.
    adapt
        Whether Poise changes the placement by itself, as `up` does.
    recording
        What `poise.up` or `poise.run` recorded: components take in each second what
        they took then, again and again; None: what they take on average. Or a bag of
        ROS 2: as many and as large messages come by the robot's bridges.
    say
        Takes a sentence at every step.
    meanwhile
        Called a few times a second with the virtual time so far [s].
    check
        Called several times a second; may raise `KeyboardInterrupt`.

    Raises
    ------
    RobotError
        There is no placement, or the file with faults is wrong.
    RunError
        The robot does not come up.
    UsageError
        A fault cannot happen to this robot, or the extra `simulate` is not installed.
    """
    asked = _scenario(robot, task, seconds, (faults, seed), recording, adapt=adapt)
    placed = first_phase(robot, asked.tasks, placement, say).placed
    return _simulated(asked, seed, placed, meanwhile, check)


def compare_simulations(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    methods: Sequence[str],
    seconds: float = 60.0,
    faults: Faults = (),
    seed: int = 0,
    adapt: bool = True,
    recording: str | PathLike[str] | None = None,
    say: Say = log.info,
    meanwhile: Watch = nothing,
    check: Check = nothing,
) -> SimulationComparison:
    """Simulate a task once for each placement, under the same seed and faults.

    After Ctrl-C it returns what is known by then.

    Parameters
    ----------
    methods
        What decides the placements, as `poise.place` takes it, such as ``auto`` and
        ``static``. The others are as in `simulate`.

    Raises
    ------
    RobotError
        The file with faults is wrong.
    UsageError
        As in `simulate`, or there is no such method.
    """
    check_names("methods", methods)
    if not methods:
        raise UsageError("name the placements to compare, such as auto and static")
    asked = _scenario(robot, task, seconds, (faults, seed), recording, adapt=adapt)
    without: dict[str, str] = {}
    placements: dict[str, Placement] = {}
    say_once = _once(say)
    for method in dict.fromkeys(methods):
        try:
            planned = place(robot, asked.tasks[0], method=method, fewer=True)
            first = first_phase(robot, asked.tasks, planned, say_once)
            placements[method] = first.placed
        except RobotError as error:
            without[method] = str(error)
    results: dict[str, Simulation] = {}
    for method, placed in placements.items():
        say(f"simulating {method} placement")
        try:
            results[method] = _simulated(asked, seed, placed, meanwhile, check)
        except RunError as error:
            without[method] = str(error)
        except KeyboardInterrupt:
            if not results:
                raise
            break
        else:
            if results[method].is_early:
                break
    return SimulationComparison(results=results, without=without)


def _once(say: Say) -> Say:
    """Return what says each sentence once, though it is true of several placements."""
    said: set[str] = set()

    def say_once(sentence: str) -> None:
        if sentence not in said:
            said.add(sentence)
            say(sentence)

    return say_once


def _scenario(
    robot: Robot,
    task: str | None,
    seconds: float,
    faults: tuple[Faults, int],
    recording: str | PathLike[str] | None,
    *,
    adapt: bool,
) -> RehearsalPlan:
    """Return what the user asks for, but for the placement, if it can be simulated."""
    _, plan = _engine()  # before anything is decided
    check_duration("a simulation", seconds)
    check_type("seed", faults[1], Integral, "a whole number")
    check_path("recording", recording or "")
    chosen = task_of(robot, task)
    asked = plan(
        robot=as_learned(robot, [chosen]),
        placement={},
        method="",
        tasks=(chosen,),
        profile=read_profile(robot),
        faults=faults_of(robot, faults[0], seconds, faults[1]),
        adapts=adapt,
        seconds=seconds,
    )
    if recording is None:
        return asked
    path = Path(recording)
    if is_bag(path):
        return structs.replace(asked, bag=bag_traffic(robot, path))
    return structs.replace(asked, cores=RecordedRun(path).cores(robot))


def _simulated(
    asked: RehearsalPlan, seed: int, placed: Placement, meanwhile: Watch, check: Check
) -> Simulation:
    scenario = structs.replace(
        asked,
        placement=placed.where,
        method=placed.method,
        suspended=placed.why_suspended,
    )
    rehearsal, _ = _engine()
    check()
    with closing(rehearsal(scenario, seed)) as simulated:
        with interrupts_held():
            simulated.come_up()
        with suppress(KeyboardInterrupt):  # the report says that it was ended early
            _go_on(simulated, asked.seconds, meanwhile, check)
        return Simulation.of(simulated.report())


def _go_on(
    simulated: Rehearsal, seconds: float, meanwhile: Watch, check: Check
) -> None:
    """Let virtual time [s] pass; a defect of Poise may keep it from passing."""
    before = -1.0
    while before < simulated.now < seconds - _ROUNDING:
        check()
        before = simulated.now
        with interrupts_held():
            simulated.advance(min(_STEP, seconds - before))
        meanwhile(simulated.now)


def _engine() -> tuple[type[Rehearsal], type[RehearsalPlan]]:
    """Return what simulates; UsageError when its extra is missing."""
    try:
        from poise.simulation.rehearsal import Rehearsal, RehearsalPlan
    except ImportError as error:
        raise UsageError(
            f"simulating needs greenlet: pip install 'poise[simulate]' ({error})"
        ) from error
    return Rehearsal, RehearsalPlan


class Simulation(Printable, SimulationReport, frozen=True, kw_only=True):
    """A simulated robot. It prints itself as tables, in a terminal and in a notebook.

    `seconds` is less than `asked` when it was ended early, as by Ctrl-C.
    """

    @classmethod
    def of(cls, report: SimulationReport) -> Simulation:
        """Return a report as one that prints itself."""
        return cls(**structs.asdict(report))

    @property
    def is_early(self) -> bool:
        """Whether it was ended before the time that was asked for."""
        return ended_early(self)

    @property
    def failed(self) -> bool:
        """Whether a promise of Poise did not hold."""
        return bool(self.violations)

    @property
    def verdict(self) -> str:
        """What came of it, in one sentence."""
        return verdict(self)

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return tuple(simulation_parts(self))

    def picture(self) -> str:
        """Return the computers' CPU over time, with faults, moves and outages."""
        return simulation_picture(self)

    def page(self) -> str:
        """Return an HTML page that needs no other file, and no network."""
        return simulation_page(self, self.html())


class SimulationComparison(Printable, Struct, frozen=True, kw_only=True):
    """The same robot under the same faults, placed by several methods.

    Parameters
    ----------
    results
        Method -> what came of it.
    without
        Method -> why there is no result: no placement, or the robot did not come up.
    """

    results: Mapping[str, Simulation]
    without: Mapping[str, str] = {}

    @property
    def failed(self) -> bool:
        """Whether a promise of Poise did not hold, or a method has no result."""
        return bool(self.without) or any(each.failed for each in self.results.values())

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return tuple(comparison_parts(self.results, self.without))

    def page(self) -> str:
        """Return an HTML page that needs no other file, and no network."""
        return comparison_page(self.results, self.html())
