"""Carries out the tasks of a running robot: starts what actions need, and stops it.

Agents keep the state that the next manager needs to go on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from functools import cache, partial

import msgspec
from msgspec.structs import replace

from poise.clock import boot_id, boot_time
from poise.errors import PoiseError, RunError, UsageError
from poise.estimate.outcomes import Conditions, Ending, note_outcome
from poise.manage.adaptation.policy_values import values_of
from poise.manage.adaptation.situation import Situation
from poise.manage.adaptation.when_to_act import Backoff
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import DoesNotStart, LiveRobot
from poise.manage.migration.transition_run import transit
from poise.manage.tasks.action_placement import (
    Admission,
    LikelyAction,
    PlanOverTime,
    Room,
    beyond_memory,
    likely_next,
)
from poise.manage.tasks.component_reports import (
    ComponentReports,
    Serving,
    choose,
    conditions_of,
)
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.switch import IdleComponents, LaterError, SlowStarts, switch
from poise.manage.tasks.task_progress import ActionEnded, Attempt, Saved, TaskRecord
from poise.manage.tasks.task_reports import OVER, TaskReport
from poise.model.condition import Condition, parse_condition
from poise.model.policy import SUBJECTS, Subject
from poise.model.robot import Architecture
from poise.model.steps import Action, Choice, Task, Until
from poise.wire.records.status_records import ActionEnd

_ROOM_AGAIN, _ROOM_AT_MOST = 2.0, 60.0
"""A task that waits for room is looked at again after this time [s], then after twice
as long, up to this, until something changes."""
_MOST_ROUNDS = 50
"""So many times in one round something may end or begin at once."""


class TaskManager:
    """The tasks of a running robot; any thread may read `reports`."""

    def __init__(
        self,
        live: LiveRobot,
        saved: Saved,  # what was started already; it is changed
        situation: Callable[[], Situation],
    ) -> None:
        self._live = live
        self._situation = situation
        say = partial(live.journal.note, "decided")
        self.tasks = Tasks(live.robot, say, self._choose, saved)
        self._plans = PlanOverTime(live.robot, live.solve_steps)
        self._serving = Serving(live)
        self.tasks.saved.boot = boot_id()
        self._room = Admission(live, self.tasks, self._plans, self._serving)
        self._component_reports = ComponentReports(live, self.tasks.saved.heard)
        self._idle = IdleComponents(live)
        self._slow = SlowStarts(live)
        self._has_begun = False  # before, what is suspended counts as due
        self._room_again = Backoff(_ROOM_AGAIN, _ROOM_AT_MOST)
        self._lost: AbstractSet[str] = frozenset()
        self._suspended: AbstractSet[str] = frozenset()
        self._unlearned: list[tuple[ActionEnded, list[str]]] = []
        self._looked_ahead: dict[tuple[Choice, Conditions], int] = {}
        self._since = boot_time()
        self._upcoming: list[tuple[Attempt, float]] = []
        self.reports = self._reported()

    def now(self) -> tuple[Task, ...]:
        """Return what runs now, as tasks of one phase; what always runs has no name."""
        tasks = [self._now(record) for record in self.tasks.going()]
        if fixed := self._serving.fixed():
            always = Action(name="always", functions=tuple(sorted(fixed)))
            tasks.append(Task(name="", actions=(always,)))
        return tuple(tasks)

    def likely_next(self) -> list[LikelyAction]:
        """Return what may be needed next and does not run, the most probable first."""
        live = self._live
        runs = live.placement() | self._slow.placement()
        idle, served = live.prepared(), self._serving.functions()
        return likely_next(self._upcoming, self._plans, runs, idle, served)

    def is_over(self) -> bool:
        """Return whether no task runs, waits or is paused any more."""
        return all(record.state in OVER for record in self.tasks.records)

    def advance(self, suspended: Iterable[str] = ()) -> None:
        """End and begin what is due, and leave idle what is not needed."""
        self._suspended = frozenset(suspended)
        self._process_reports()
        self.tasks.end_due(boot_time(), self._condition_holds)
        self._note_ended()
        self._go_on()
        self._idle.drop_expired(self._kept())
        self._save()

    def report(self, task: str) -> TaskReport:
        """Return how a task is that was started; of several the last."""
        return next(r for r in reversed(self.reports) if r.name == task)

    def has_news(self) -> bool:
        """Return whether an action has ended, or can begin at last."""
        return bool(self._reported_ends()) or self._slow.is_due()

    def command(self, verb: str, name: str, priority: int | None = None) -> None:
        """Start, pause, resume or cancel a task, and do what follows."""
        self._since = now = boot_time()
        if verb == "start":
            self.tasks.start(name, now, priority)
        else:
            getattr(self.tasks, verb)(name, now)
        self._room_again.reset()
        self._go_on()
        self._save()

    def _now(self, record: TaskRecord) -> Task:
        """Return what runs now of a task."""
        actions = tuple(  # nothing needs what is done on failure, until one has failed
            replace(attempt.action, on_failure="give up")
            for attempt in self.tasks.tries(record)
            if not self._has_begun or attempt.is_at_work
        )
        used = {function for action in actions for function in action.functions}
        needs = tuple(n for n in self._live.robot.task(record.name).needs if n in used)
        return Task(name=record.name, actions=actions, needs=needs)

    def _go_on(self) -> None:
        """Let what should run now run, until nothing changes by that."""
        now, lost = boot_time(), set(self._live.agents.out_of_reach())
        if lost != self._lost:
            self._lost = lost
            self._room_again.reset()
        if now >= self._room_again.again_at:
            self._room_again.start(now)
            self.tasks.unblock()
        for _ in range(_MOST_ROUNDS):
            self.tasks.arbitrate(boot_time())
            if not self._reconcile():
                break
        self._has_begun = True
        self.tasks.announce()
        self._learn()

    def _reconcile(self) -> bool:
        """Idle what no action needs, begin what is due; return whether one ended."""
        wanted = self.tasks.functions_of(self.tasks.going())
        ends = [a for a in self._serving.moving() if a.function not in wanted]
        new = [each for each in self.tasks.due() if not each.is_at_work]
        if not ends and not new:
            self._slow.keep({})
            return False
        self._save(tell_later=True)  # this manager may be killed amid the switch
        needed = {name for each in new for name in each.action.functions}
        if self._lost and (gone := self._serving.replaceable(self._lost, needed)):
            why = "an alternative takes the place of what is on a lost computer"
            self._live.commit(self._live.desired.without(gone), why)
        room = Room()
        there = self._serving.functions() | self._serving.broken(self._lost)
        if wanted - there - self._suspended:
            room = self._room.admit(self._situation(), new, self._suspended)
        if room.why:
            self._note_ended()
            return True
        return self._switch(new, ends, room)

    def _switch(self, new: list[Attempt], ends: list[Architecture], room: Room) -> bool:
        """Carry a switch out; return whether to go on with what follows at once."""
        live = self._live
        stops = [c.name for a in ends for c in a.components if c.name in live.placed]
        self._slow.keep(room.begins)
        try:
            begins = self._slow.ready(room.begins)
        except RunError as error:
            self._fail(new, self._slow.placement(), error)
            self._slow.keep({})
            return False
        is_hit = False
        since = min(self._since, self._slow.since(begins))
        heard = self._component_reports.ends()
        try:
            stops = self._make_room(room, begins, [*stops, *room.ends])
            if stops or begins:
                is_hit = switch(live, stops, begins)
        except LaterError as error:
            self._slow.note(begins, since, error.delay)
            begins = {}
        except RunError as error:
            self._fail(new, begins, error)
            return False  # that took its time: the robot is looked after in between
        served = self._serving.functions() | self._suspended
        began = [each for each in new if served.issuperset(each.action.functions)]
        for attempt in began:
            if not self._has_turn(attempt):  # else what it said meanwhile counts
                said = heard.get(str(attempt.action.ends))
                attempt.progress.heard = said.count if said else 0
            self.tasks.began(attempt.number, boot_time())
            if begins:
                self._note_switch(attempt, since, is_hit=is_hit)
        return self._fail_endless(began)

    def _has_turn(self, attempt: Attempt) -> bool:
        """Return whether its component began with this action, and no other since."""
        end = attempt.action.ends
        placed = self._live.placed.get(end.component) if end is not None else None
        return placed is not None and [*placed.actions][-1:] == [attempt.number]

    def _fail_endless(self, began: Iterable[Attempt]) -> bool:
        """End actions whose end nothing will report; return whether there are any."""
        endless = False
        for attempt in began:
            if why := self._serving.why_endless(attempt.action.ends):
                endless = True
                self.tasks.end(attempt.number, boot_time(), why, done=False)
        self._note_ended()
        return endless

    def _with_turns(self) -> Desired:
        """Return what should run, when components know which actions begin."""
        placed = dict(self._live.placed)
        going_on = {
            attempt.number
            for record in self.tasks.records
            if record.state not in OVER
            for attempt in self.tasks.tries(record)
        }
        for attempt in self.tasks.due():
            end, number = attempt.action.ends, attempt.number
            if end is None or not attempt.is_at_work:
                continue
            component = placed.get(end.component)
            if component is not None and number not in component.actions:
                known = {n: a for n, a in component.actions.items() if n in going_on}
                actions = {**known, number: attempt.action.name}
                placed[end.component] = replace(component, actions=actions)
        return replace(self._live.desired, placed=placed)

    def _make_room(
        self, room: Room, begins: Mapping[str, str], stops: list[str]
    ) -> list[str]:
        """Move what is in the way, end what may not stay idle; return what may."""
        live = self._live
        if room.moves:
            report = transit(live, room.moves)
            if not report.committed:
                raise RunError(report.reason)
        away = live.agents.out_of_reach()
        idle = {n: e.computer for n, e in live.prefetched.items() if n not in begins}
        idle |= {n: live.placed[n].computer for n in stops if n not in begins}
        works = {n: at for n, at in live.placement().items() if n not in idle}
        order = self._idle.oldest_first(idle)
        gone = beyond_memory(live.robot, {**works, **begins}, idle, order)
        if gone:
            what = f"there is not enough memory to keep {', '.join(gone)} idle"
            live.journal.note("decided", what)
        gone += [n for n in stops if live.placed[n].computer in away]
        if gone:
            why = "it cannot stay idle: no memory, or its computer is out of reach"
            live.commit(live.desired.without(gone), why)
        return [name for name in stops if name not in gone]

    def _fail(self, new: list[Attempt], begins: Iterable[str], error: RunError) -> None:
        """End the actions that cannot begin or go on; the others stay as they are."""
        why = str(error)
        self._live.journal.note("failed", f"an action cannot begin: {why}")
        functions = self._serving.functions_of(begins)
        # of a traceback the last line says most
        short = " ".join(dict.fromkeys([why.splitlines()[0], why.splitlines()[-1]]))
        for attempt in self.tasks.due() if functions else new:
            if not functions or functions.intersection(attempt.action.functions):
                how = "go on" if attempt.is_at_work else "begin"
                what = f"it cannot {how}: {short}"
                self.tasks.end(attempt.number, boot_time(), what, done=False)
        self._note_ended(error.component if isinstance(error, DoesNotStart) else "")

    def _process_reports(self) -> None:
        """End the actions whose components say so, and do what components request."""
        now = boot_time()
        for attempt, said in self._reported_ends():
            what = f"'{attempt.action.ends}' reported its end"
            self.tasks.end(attempt.number, now, what, done=said.done)
        self._note_ended()
        note = self._live.journal.note
        for component, request in self._component_reports.requests():
            asks = f"asks to {request.verb} task '{request.task}'"
            what = f"component '{component}' {asks}"
            note("seen", what)
            try:
                self.command(request.verb, request.task)
            except UsageError as error:
                note("wrong", f"{what}: {error}")

    def _reported_ends(self) -> list[tuple[Attempt, ActionEnd]]:
        """Return the actions that are at work, and that a component says to end."""
        due = self.tasks.due()
        turns = [each for each in due if each.is_at_work and each.action.ends]
        heard, ended = self._component_reports.ends() if turns else {}, []
        for attempt in turns:
            said = heard.get(str(attempt.action.ends))
            if said and said.count != attempt.progress.heard:
                ended.append((attempt, said))
        return ended

    def _note_ended(self, broken: str = "") -> None:
        """Remember what has ended, and what served it; `broken` could not begin."""
        blamed = self._live.robot.architecture_of(broken) if broken else None
        for ended in self.tasks.pop_ended():
            self._since = boot_time()
            self._room_again.reset()
            end = ended.action.ends
            if blamed is not None and blamed.function in ended.action.functions:
                self._unlearned.append((ended, [blamed.name]))
            if not ended.worked or (end and end.component not in self._live.placed):
                continue  # nothing could do it, or report it: none of them is to blame
            serving = self._serving.architectures(ended.action.functions)
            self._unlearned.append((ended, serving))

    def _learn(self) -> None:
        """Learn from what has ended: that takes longer than a switch."""
        for ended, serving in self._unlearned:
            robot, name = self._live.robot, ended.action.name
            if not self._live.learns or not robot.folder or not serving:
                continue
            ending: Ending = "done" if ended.done else "failed"
            conditions = conditions_of(self._situation())
            try:
                note_outcome(robot, name, ending, serving, conditions=conditions)
            except PoiseError as error:
                what = f"the outcome of '{name}' is not learned: {error}"
                self._live.journal.note("failed", what)
        if self._unlearned:
            self._looked_ahead.clear()
        self._unlearned.clear()

    def _condition_holds(self, until: Until) -> bool:
        condition = _parsed(until.when, until.subject)
        return any(
            condition(subject)
            for subject in values_of(self._situation(), until.subject)
            if not until.name or subject.name == until.name
        )

    def _choose(self, choice: Choice, is_lookahead: bool) -> int:  # noqa: FBT001
        """Return which step of a choice is done; a look ahead reads no code twice."""
        note, conditions = self._live.journal.note, conditions_of(self._situation())
        known = self._looked_ahead.get((choice, conditions))
        if is_lookahead and known is not None:
            return known
        try:
            index = choose(
                self._live.robot,
                choice,
                conditions,
                lambda text: None if is_lookahead else note("decided", text),
            )
        except PoiseError as error:
            note("failed", f"the first option of a choice is taken: {error}")
            index = 0
        self._looked_ahead[choice, conditions] = index
        return index

    def _kept(self) -> set[str]:
        """Return what keeps its state for a task that waits or is paused."""
        halted = (r for r in self.tasks.records if r.state in {"waiting", "paused"})
        return self._live.robot.components_for(self.tasks.functions_of(halted))

    def _note_switch(self, attempt: Attempt, since: float, *, is_hit: bool) -> None:
        seconds = boot_time() - since
        self._live.switches.note(seconds, is_hit=is_hit)
        how = "it was prepared" if is_hit else "it was not prepared"
        text = f"switched to action '{attempt.name}' in {seconds:.3f} s: {how}"
        facts = {"task": attempt.task, "is_hit": is_hit, "seconds": seconds}
        self._live.journal.note("done", text, **facts)

    def _save(self, *, tell_later: bool = False) -> None:
        """Let components and the next manager know what they need, if that is new."""
        self._upcoming = self.tasks.next_actions()
        self.reports = self._reported()
        live, saved = self._live, msgspec.msgpack.encode(self.tasks.saved)
        desired = replace(self._with_turns(), tasks=saved)
        if desired != live.desired:
            live.commit(desired, "tasks go on", tell_later=tell_later)

    def _reported(self) -> tuple[TaskReport, ...]:
        def serving(attempt: Attempt) -> tuple[str, ...]:
            return tuple(self._serving.architectures(attempt.action.functions))

        return self.tasks.reports(self._upcoming, serving, boot_time())


@cache
def _parsed(when: str, subject: Subject) -> Condition:
    return parse_condition(when, SUBJECTS[subject])
