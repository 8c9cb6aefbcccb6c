"""Where the functions of the actions that run now go, and which task waits for room."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from itertools import chain

from msgspec import Struct
from msgspec.structs import replace

from poise import plan
from poise.clock import boot_time
from poise.errors import PoiseError, RobotError, UsageError
from poise.estimate.success_rates import learned
from poise.manage.adaptation.proposal import SOLVE_FOR, taken_by_others
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import TransitionStep
from poise.manage.migration.transition_plan import plan_transition, residue
from poise.manage.tasks.component_reports import Serving, conditions_of
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.task_progress import Attempt, TaskRecord
from poise.model.robot import Robot
from poise.model.steps import Retry
from poise.units import named

MOVE = 0.01
"""What F grows by for a component that moves, and for each MB of its state."""


class Room(Struct, frozen=True, kw_only=True):
    """Where functions go, or why they do not fit."""

    begins: Mapping[str, str] = {}  # component -> computer, of what does not run yet
    ends: Collection[str] = ()  # components whose place an alternative takes
    moves: tuple[TransitionStep, ...] = ()  # what moves before, to make room
    why: str = ""  # why there is no room; empty: there is


def room_for_functions(
    situation: Situation,
    functions: Iterable[str],
    by_plan: Mapping[str, str],  # component -> computer; it counts where it fits
) -> Room:
    """Return where functions go, beside their running components.

    What runs stays where it is, if all fits so; else it moves where it may. If all runs
    already, it needs no more room, whatever other programs take meanwhile.
    """
    here = situation.within_reach()
    robot = _with_chosen(here.left().robot_now, here.placement)
    try:
        problem = plan.problem_of(
            robot, functions=functions, present=here.placement, move=MOVE
        )
        names = {component.name for component in problem.components}
        present = {n: at for n, at in here.placement.items() if n in names}
        hinted = {**by_plan, **present}
        if _is_placement(problem, hinted, runs=hinted == present):
            return Room(begins={n: at for n, at in hinted.items() if n not in present})
        result = plan.solve(problem, SOLVE_FOR, steps=here.solve_steps)
        if not result.feasible:
            return Room(why=_why(result, situation))
        then = result.placement
        kept = {name: then[name] for name in present if name in then}
        moves = plan_transition(robot, present, {**present, **kept})
    except RobotError as error:
        return Room(why=str(error))
    begins = {n: at for n, at in then.items() if n not in present}
    return Room(begins=begins, moves=moves)


def _why(result: plan.Result, situation: Situation) -> str:
    why = result.reason or "there is no room"
    takes = taken_by_others(situation) if " cpu" in why else ""
    return f"{why}. Other programs take {takes}" if takes else why


def beyond_memory(
    robot: Robot,
    placement: Mapping[str, str],
    prepared: Mapping[str, str],
    order: Iterable[str],
) -> list[str]:
    """Return what of the prepared components must go, so that memory is enough."""
    needs = robot.demands("memory")
    left = residue(robot, {**placement, **prepared})
    gone = []
    for name in order:
        here = left.get(prepared[name], {})
        if here.get("memory", 0.0) < 0 < needs.get(name, 0.0):
            here["memory"] += needs[name]
            gone.append(name)
    return gone


def _is_placement(
    problem: plan.Problem, placement: Mapping[str, str], *, runs: bool
) -> bool:
    """Return whether a placement is one of the problem; and runs, or keeps limits."""
    try:
        result = plan.evaluate(problem, placement)
    except UsageError:  # two tasks planned with alternatives, or a computer was lost
        return False
    return (runs or result.feasible) and result.placement.keys() == placement.keys()


def _with_chosen(robot: Robot, placement: Mapping[str, str]) -> Robot:
    """Return the robot without the alternatives of architectures that run."""
    running = {
        a.function: a.name
        for a in robot.architectures
        if any(c.name in placement for c in a.components)
    }
    chosen = (
        a for a in robot.architectures if running.get(a.function, a.name) == a.name
    )
    return replace(robot, architectures=tuple(chosen))


PLAN_FOR = 0.3
"""The phases of a task are placed within this time [s], when it is planned first."""


class LikelyAction(Struct, frozen=True, kw_only=True):
    """Components that may be needed soon."""

    what: str  # which action of which task needs them, for people; empty: none
    placement: Mapping[str, str]  # component -> computer, without what runs already
    probability: float  # that this action comes next in its task


class PlanOverTime:
    """The placements of the phases of a robot's tasks, made when first asked for."""

    def __init__(self, robot: Robot, solve_steps: int | None = None) -> None:
        self._robot = robot
        self._steps = solve_steps
        self._phases: dict[str, plan.TaskResult | None] = {}

    def placement(
        self, task: str, actions: tuple[str, ...], functions: tuple[str, ...]
    ) -> Mapping[str, str]:
        """Return where functions are provided while actions run; empty: unknown."""
        result = self._of(task)
        wanted = self._robot.components_for(functions)
        for name, phase in result.results.items() if result else ():
            if set(actions) <= set(name.split("+")):
                return {n: at for n, at in phase.placement.items() if n in wanted}
        return {}

    def _of(self, task: str) -> plan.TaskResult | None:
        if task not in self._phases:
            self._phases[task] = None
            with suppress(PoiseError):  # where it is needed, the reason is said
                self._phases[task] = plan.solve_phases(
                    plan.task_problem_of(self._robot, task),
                    PLAN_FOR,
                    steps=self._steps,
                    why=False,
                )
        return self._phases[task]


def likely_next(
    upcoming: Iterable[tuple[Attempt, float]],
    plans: PlanOverTime,
    running: Mapping[str, str],
    idle: Mapping[str, str],
    served: Collection[str] = (),  # functions that run, maybe by other alternatives
) -> list[LikelyAction]:
    """Return what may be needed next and does not run, the most probable first."""
    actions = []
    for attempt, probability in upcoming:
        functions = tuple(f for f in attempt.action.functions if f not in served)
        where = plans.placement(attempt.task, (attempt.name,), functions)
        missing = {n: idle.get(n, at) for n, at in where.items() if n not in running}
        if missing:
            actions.append(
                LikelyAction(
                    what=str(attempt), placement=missing, probability=probability
                )
            )
    return sorted(actions, key=lambda action: -action.probability)


class Admission:
    """Decides where the functions of all tasks go together."""

    def __init__(
        self, live: LiveRobot, tasks: Tasks, plans: PlanOverTime, serving: Serving
    ) -> None:
        self._live = live
        self._tasks = tasks
        self._plans = plans
        self._serving = serving

    def admit(
        self,
        situation: Situation,
        new: Collection[Attempt],
        suspended: AbstractSet[str],
    ) -> Room:
        """Return where all goes that should run now.

        When it does not fit, tasks of low priority wait for the room of others; when
        one does not even fit alone, its actions fail. The room then says why.
        """
        robot = learned(
            situation.robot,
            [attempt.action for attempt in new],
            conditions=conditions_of(situation),
            seed=self._tasks.saved.number,
        ).robot
        situation = replace(situation, robot=self._without_stuck(robot))
        left_out = suspended | self._serving.broken(situation.lost)
        going, due, by_plan = self._tasks.going(), self._tasks.due(), dict[str, str]()
        for attempt in new:
            names = tuple(each.name for each in due if each.task == attempt.task)
            functions = attempt.action.functions
            by_plan |= self._plans.placement(attempt.task, names, functions)
            if attempt.progress.spent:
                by_plan = self._with_resting(by_plan, functions)
        whole = self._beside(situation, going, left_out, by_plan)
        if whole.why and (gone := self._exchangeable(due)):
            left = {n: at for n, at in situation.placement.items() if n not in gone}
            there = replace(situation, placement=left)
            other = self._beside(there, going, left_out, by_plan)
            ends = gone - other.begins.keys()
            if not other.why and len(ends) == len(gone):
                old = sorted({f"'{robot.architecture_of(n).name}'" for n in ends})
                what = f"an alternative takes the place of {', '.join(old)}"
                self._live.journal.note("decided", f"{what}: {whole.why}")
                return replace(other, ends=sorted(ends))
        if not whole.why:
            return whole
        for count in range(len(going) - 1, 0, -1):
            if not self._beside(situation, going[:count], left_out, by_plan).why:
                others = named("task", [record.name for record in going[:count]])
                for record in going[count:]:
                    use = "uses" if count == 1 else "use"
                    text = f"{others} {use} capacity that this one needs: {whole.why}"
                    self._tasks.block(record.name, text)
                return whole
        self._end_or_block(going[0], whole.why)
        return whole

    def _without_stuck(self, robot: Robot) -> Robot:
        """Return it without what cannot begin, but has an alternative that can.

        What an action ended may be at work yet, on a computer that is out of reach.
        """
        live, away = self._live, self._live.agents.out_of_reach()
        stuck = {
            each.component
            for each in live.desired.left_behind
            if each.computer in away
            and each.component not in live.placed
            and (
                each.component not in live.layout.leased
                or live.agents.heartbeats.is_heard(each.computer)
            )
        }
        free = [
            a
            for a in robot.architectures
            if stuck.isdisjoint(c.name for c in a.components)
        ]
        functions = {a.function for a in free}
        lacking = (a for a in robot.architectures if a.function not in functions)
        return replace(robot, architectures=(*free, *lacking))

    def _exchangeable(self, due: Iterable[Attempt]) -> set[str]:
        """Return what runs for no action at work, and has alternatives for new ones."""
        functions, at_work = set[str](), set[str]()
        for attempt in due:
            is_new = not attempt.is_at_work
            (functions if is_new else at_work).update(attempt.action.functions)
        return {*chain(*self._serving.exchangeable(functions - at_work))}

    def _with_resting(
        self, by_plan: Mapping[str, str], functions: Collection[str]
    ) -> dict[str, str]:
        """Return a plan with the alternatives that rested last, with their state."""
        robot, desired = self._live.robot, self._live.desired
        idle = (*desired.prefetched.values(), *desired.configured_ahead)
        resting = {e.component: e.computer for e in idle if e.has_worked}
        for function in functions:
            own = robot.components_for([function])
            if not (last := [name for name in resting if name in own][-1:]):
                continue
            names = {c.name for c in robot.architecture_of(last[0]).components}
            if names <= resting.keys():
                kept = {n: at for n, at in by_plan.items() if n not in own}
                by_plan = {**kept, **{name: resting[name] for name in names}}
        return dict(by_plan)

    def _end_or_block(self, record: TaskRecord, why: str) -> None:
        """End what does not fit though no other task runs; what has worked waits."""
        now = boot_time()
        for attempt in self._tasks.tries(record):
            if not attempt.is_at_work and not attempt.progress.spent:
                text = f"it does not fit: {why}"
                if isinstance(retry := attempt.action.on_failure, Retry):
                    attempt.progress.rounds = retry.times  # it would fit no better now
                self._tasks.end(attempt.number, now, text, done=False)
                return
        self._tasks.block(record.name, f"it does not fit any more: {why}")

    def _beside(
        self,
        situation: Situation,
        going: Sequence[TaskRecord],
        left_out: AbstractSet[str],
        by_plan: dict[str, str],
    ) -> Room:
        """Return where the functions of some tasks go, when all others are idle."""
        functions = self._tasks.functions_of(going) | self._serving.fixed()
        functions -= left_out
        runs = situation.robot.components_for(functions)
        placement = {n: at for n, at in situation.placement.items() if n in runs}
        ahead = self._live.desired.configured_ahead
        idle = self._live.prepared() | {e.component: e.computer for e in ahead}
        hint = {n: idle.get(n, at) for n, at in by_plan.items() if n in runs}
        here = replace(situation, placement=placement)
        return room_for_functions(here, functions, hint)
