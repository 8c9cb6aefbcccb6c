"""A robot's components, running: started, waited for, ended."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

from msgspec import structs

from poise.errors import RunError
from poise.manage.agent_connections.statuses import (
    components_of,
    containers_left,
    cut_links,
    located,
    not_at_goals,
    not_joined,
    unresponsive_containers,
)
from poise.manage.deploy.desired import Desired, Incarnation
from poise.manage.deploy.desired_state import DesiredState
from poise.manage.deploy.unreached import unreached
from poise.manage.observe.deviations import (
    Numbers,
    combined,
    faults_after,
    last_numbers,
)
from poise.units import counted
from poise.wire.heartbeats import LEASES_END_WITHIN
from poise.wire.records.deployment_records import Goal
from poise.wire.records.status_records import (
    ENDING_LIMIT,
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    Fault,
)

READY_LIMIT = 20.0
"""All components are configured and all connectors joined within this time [s]."""
ACTIVE_LIMIT = 10.0
STOP_LIMIT = ENDING_LIMIT + 5.0
"""Containers that were asked to end have ended within this time [s]."""
_LOOK_EVERY = 0.02
_BACK_WITHIN = 10.0
"""A computer may be out of reach for so long while the robot starts [s]."""
_CRASHES = 5
"""A component does not start whose container has ended so often since it was to run."""


class DoesNotStart(RunError):
    """A component that was to run has failed by its own doing."""

    def __init__(self, component: str, error: str, where: str = "") -> None:
        super().__init__(f"component '{component}'{where} failed:\n{error}")
        self.component = component


class NotReady(RunError):
    """What was waited for is not ready in time, and nothing else is wrong with it."""


class LiveRobot(DesiredState):
    """The robot as it is at work, and as it should be."""

    remaining = ""
    """What still runs after a stop, in words."""
    has_taken_over = False
    """Whether it was at work under another manager before."""
    solve_steps: int | None = None
    """How much the planner searches, so that a simulation can be repeated; None: as
    its time allows."""
    learns = True
    """Whether how actions end is kept for later choices: not what is simulated."""
    goes_on_without_lost = False
    """Whether a lost computer is a deviation; else it ends what waits."""
    _away_since: Mapping[str, float] = {}
    _faults_before_commit: Mapping[str, int] = {}

    def commit(self, desired: Desired, why: str, *, tell_later: bool = False) -> None:
        """Let something else run from now on; faults after that explain a wait."""
        self._faults_before_commit = last_numbers(self.agents.statuses())
        if desired != self.desired:
            left = tuple(self._left_behind(desired))
            desired = structs.replace(desired, left_behind=left)
        super().commit(desired, why, tell_later=tell_later)

    def _left_behind(self, desired: Desired) -> Iterator[Incarnation]:
        """Yield what is to end once something else runs, or has not ended yet."""
        away = self.agents.out_of_reach()
        wanted = {i.key for i in desired.incarnations() if i.goal == "active"}
        for each in desired.left_behind:
            is_there = each.computer in away or not self.has_ended(each)
            if is_there and each.key not in wanted:
                yield each
        known = wanted.union(each.key for each in desired.left_behind)
        for each in self.desired.incarnations():
            # what was only planned was told to nobody
            is_told = self.desired.generation > 0
            if is_told and each.goal == "active" and each.key not in known:
                yield each

    def end_left_behind(
        self, coming: Collection[Incarnation], lost: Collection[str] = ()
    ) -> None:
        """Wait until no earlier incarnation of what is to be active is at work.

        Where it is out of reach, it has its lease while another agent hears its
        computer. Raises RunError: it may still be at work.

        `lost`: the computers out of reach where the incarnations now placed ran.
        """
        keys = {i.key for i in coming}
        names = {i.component for i in coming}
        left = [
            i
            for i in self.desired.left_behind
            if i.component in names and i.key not in keys
        ]
        away = {i.computer for i in left} & self.agents.out_of_reach().keys()
        for each in left:  # no lease ends what is not movable
            if each.computer in away and each.component not in self.layout.leased:
                raise RunError(
                    f"component '{each.component}' may still be at work on "
                    f"'{each.computer}', which is out of reach"
                )
        for incarnation in left:
            if incarnation.computer not in away:
                self.wait_ended(incarnation)
        # all at once, and last: what comes back while this waits goes on as it was
        if away := away.union(lost):
            self.revoke_leases(away)

    def revoke_leases(self, lost: Collection[str]) -> None:
        """Wait until nothing of lost computers can be active there any more."""

        def is_back() -> bool:
            self.poll()
            return not self.computers().isdisjoint(lost)

        names = " or ".join(f"'{name}'" for name in sorted(lost))
        deadline = self.clock.now() + LEASES_END_WITHIN
        while not self.agents.revoke(lost):
            if heard := sorted(filter(self.agents.heartbeats.is_heard, lost)):
                text = f"heartbeats still come from {' and '.join(map(repr, heard))}"
                raise RunError(text)
            if self.agents.wait_news(is_back, _LOOK_EVERY):
                raise RunError(f"{names} is reached again")
            if self.clock.now() > deadline:
                raise RunError(f"components of {names} may still be at work")

    def start(self) -> None:
        """End what an earlier manager left, and start everything."""
        self.agents.claim(self.computers())
        self.claimed |= self.computers()
        if left := containers_left(self.agents.statuses(), self.computers()):
            text = f"stopping what an earlier manager left: {', '.join(left)}"
            self.journal.note("seen", text)
            placed = self.desired
            self.end_all("an earlier manager left something")
            self.commit(placed, "its containers have ended")
        self.start_all()

    def start_all(self) -> None:
        """Start everything, all inactive first, then active; as `start`."""
        what = f"starting {counted(len(self.placed), 'component')}"
        self.journal.note("decided", what)
        self.reach("inactive", READY_LIMIT)
        self.reach("active", ACTIVE_LIMIT)
        self.journal.note("done", "all components run", placement=self.placement())

    def watch(self, seconds: float) -> None:
        """Let it run for `seconds` [s]; raise RunError when something fails."""
        self.agents.wait_news(self._raise_on_trouble, seconds)

    def unreached(self, *, is_brief: bool = False) -> dict[str, str]:
        """Return what is known of computers out of reach, in words.

        `is_brief`: without what becomes of their components.
        """
        placement = {} if is_brief else self.placement()
        return unreached(self.agents, placement, self.layout.leased)

    def cancel(self) -> None:
        """End what waits for agents: a change of the placement is rolled back."""
        self.is_over.set()
        self.agents.notify()

    def end_all(self, why: str) -> None:
        """End all containers of the computers that are reached, of any manager."""
        self.commit(structs.replace(self.desired, is_stopped=True), why)

        def has_ended() -> bool:
            self.reconcile()
            return not containers_left(self.current(), self.computers())

        if not self.agents.wait_news(has_ended, STOP_LIMIT):
            refusals = map(self.reconciler.refusal, sorted(self.computers()))
            left = ", ".join(containers_left(self.current(), self.computers()))
            text = f"{left} still ran {STOP_LIMIT:g} s after the stop"
            raise RunError("; ".join(filter(None, refusals)) or text)

    def reach(self, goal: Goal, limit: float) -> None:
        """Bring every component to a goal within `limit` [s]; `start` says the rest."""
        self.commit(self.desired.aiming(goal, self.placed.keys()), f"start: {goal}")
        self.wait(self.placed.values(), limit)
        self.journal.note("done", f"all components are {goal}")

    def bring(self, coming: Collection[Incarnation], limit: float, why: str) -> None:
        """Let something run beside all else, and wait for it."""
        self.commit(self.desired.with_coming(coming), why)
        self.wait(coming, limit)

    def wait(
        self,
        wanted: Iterable[Incarnation],
        limit: float,
        trouble: Callable[[], bool] | None = None,
    ) -> None:
        """Wait until `wanted` are at their goals, and joined to what they reach.

        While the robot starts, an agent may be back in a moment, as on a busy board.
        `trouble`: called at every news; raises to end it. None: any trouble does.
        """
        wanted = tuple(wanted)
        check = trouble or self._raise_on_trouble

        def is_reached() -> bool:
            check()
            if self.goes_on_without_lost:
                self.raise_on_unreached(wanted)
            elif self.agents.out_of_reach():
                return False
            self._raise_on_refusal(wanted)
            self.raise_on_crashes(wanted, self._faults_before_commit)
            return not self.missing(wanted)

        if not self.agents.wait_news(is_reached, limit):
            self.raise_on_lost()
            missing = "; ".join(self.missing(wanted))
            raise NotReady(f"not ready within {limit:g} s: {missing}")

    def commit_lastingly(self, desired: Desired, why: str) -> None:
        """Let something else run; RunError: no majority of agents has stored it."""
        self.commit(desired, why)
        generation = self.desired.generation

        def is_stored() -> bool:
            self._raise_on_trouble()
            return self.agents.has_stored(generation)

        if not self.agents.wait_news(is_stored, READY_LIMIT):
            raise RunError(f"no majority of agents has stored {why}")

    def current(self) -> dict[str, AgentStatus]:
        """Return the statuses that speak of what the agents were told last."""
        return {
            computer: status
            for computer, status in self.agents.statuses().items()
            if self.reconciler.is_current(computer, status)
        }

    def computers(self) -> set[str]:
        """Return the names of the robot's computers that are reached."""
        known = {computer.name for computer in self.robot.computers}
        return known - self.agents.out_of_reach().keys()

    def has_ended(self, gone: Incarnation) -> bool:
        """Return whether an incarnation is not there any more, so far as is known."""
        if gone.computer in self.agents.out_of_reach():
            return True
        return gone.computer in self.current() and self.reported(gone) is None

    def reported(self, wanted: Incarnation) -> ComponentStatus | None:
        """Return what is known of an incarnation; None: nothing."""
        components = components_of(self.current())
        return next((c for c in components if c.key == wanted.key), None)

    def coming_to_rest(self) -> list[Incarnation]:
        """Return what should be idle and may be active yet; from any thread."""
        current, away = self.current(), self.agents.out_of_reach()
        active = {c.key for c in components_of(current) if c.state == "active"}
        return [
            idle
            for idle in self.desired.prefetched.values()
            if idle.key in active
            or not (idle.gently or idle.computer in current or idle.computer in away)
        ]

    def health_of(self, wanted: Incarnation) -> ContainerHealth | None:
        """Return what is known of an incarnation's container; None: nothing."""
        status = self.current().get(wanted.computer)
        name = self.layout.container_of(wanted)
        health = status.health if status is not None else ()
        return next((h for h in health if h.name == name), None)

    def wait_ended(self, gone: Incarnation) -> None:
        """Wait until an incarnation that is not wanted any more has ended."""

        def has_ended() -> bool:
            self.check()
            self.reconcile()
            self.raise_on_unreached([gone])  # there it may still run
            return self.has_ended(gone)

        if not self.agents.wait_news(has_ended, STOP_LIMIT):
            raise RunError(
                f"component '{gone.component}' still runs on '{gone.computer}' "
                f"{STOP_LIMIT:g} s after the request to stop it"
            )

    def unresponsive(self, incarnations: Iterable[Incarnation]) -> list[str]:
        """Return which of their containers do not respond, and why, in words."""
        known = unresponsive_containers(self.agents.statuses())
        if not known:
            return []
        places = dict.fromkeys(map(self.layout.container_at, incarnations))
        return [
            f"container '{place[1]}' on '{place[0]}' does not respond: {known[place]}"
            for place in places
            if place in known
        ]

    def missing(self, wanted: Collection[Incarnation]) -> list[str]:
        """Return what `wait` still waits for, in words."""
        statuses = self.current()
        silent = self._involved(wanted) & (self.computers() - statuses.keys())
        unmet = not_at_goals(wanted, statuses, silent)
        # which are to be joined takes long to find out on a large robot
        unmet = unmet or not_joined(statuses, self._joins(wanted))
        unmet += self.unresponsive(wanted) if unmet else []
        faults = faults_after(self._faults_before_commit, statuses) if unmet else ()
        return [*unmet, *combined(faults)]

    def _joins(self, wanted: Iterable[Incarnation]) -> dict[str, tuple[str, str]]:
        """Return the keys of connectors whose ends reach each other -> computers."""
        new = {
            incarnation.component: incarnation
            for incarnation in wanted
            if not incarnation.unjoined
        }
        placed = {**self.placed, **new}
        unreached = self.unreached_connectors(placed)
        joins = {}
        for connector in self.layout.connectors_at(new, placed):
            if str(connector) not in unreached:
                source, target = (
                    placed[e.component].computer for e in connector.between
                )
                joins[self.layout.key_of(connector, placed)] = source, target
        return joins

    def unreached_connectors(self, placed: Mapping[str, Incarnation]) -> dict[str, str]:
        """Return the connectors whose ends do not reach each other, and why."""
        statuses = self.agents.statuses()
        cut, is_stuck = cut_links(statuses), bool(unresponsive_containers(statuses))
        away = set(self.agents.out_of_reach())
        unreached = {}
        for connector in self.layout.connectors(placed):
            ends = [placed[end.component] for end in connector.between]
            between = sorted({incarnation.computer for incarnation in ends})
            if lost := away.intersection(between):
                unreached[str(connector)] = f"computer '{min(lost)}' is out of reach"
            elif frozenset(between) in cut:
                unreached[str(connector)] = f"link '{'-'.join(between)}' is cut"
            elif is_stuck and (stuck := self.unresponsive(ends)):
                unreached[str(connector)] = "; ".join(stuck)
        return unreached

    def _involved(self, wanted: Collection[Incarnation]) -> set[str]:
        """Return the computers of incarnations, and of what is joined to them."""
        names = {incarnation.component for incarnation in wanted}
        where = self.placement()
        joined = self.layout.connectors_at(names, where.keys() | names)
        names |= {end.component for connector in joined for end in connector.between}
        there = {where[name] for name in names & where.keys()}
        return there | {incarnation.computer for incarnation in wanted}

    def note_refused(self) -> None:
        """Journal why records of agents were refused."""
        for sentence in self.agents.pop_refused():
            self.journal.note("wrong", sentence)

    def poll(self) -> None:
        """Look around while agents are waited for; raise RunError to end that."""
        self.note_refused()
        self.check()
        self.reconcile()
        if self.is_over.is_set():
            raise RunError("the robot is being stopped")
        self.raise_on_lost(_BACK_WITHIN)

    def _raise_on_trouble(self) -> bool:
        self.poll()
        wanted = {i.key for i in (*self.placed.values(), *self.desired.coming)}
        for computer, component in located(self.agents.statuses()):
            if component.state == "failed" and component.key in wanted:
                why = DoesNotStart(component.name, component.error, f" on '{computer}'")
                self.journal.note("failed", str(why).partition(":\n")[0])
                raise why
        return False

    def raise_on_broken(self, incarnations: Collection[Incarnation]) -> None:
        """Raise RunError when one is out of reach, has failed, or does not respond."""
        self.raise_on_unreached(incarnations)
        if stuck := self.unresponsive(incarnations):
            raise RunError("; ".join(stuck))
        where = {incarnation.key: incarnation.computer for incarnation in incarnations}
        for component in components_of(self.current()):
            computer = where.get(component.key)
            if computer is not None and component.state == "failed":
                raise RunError(
                    f"component '{component.name}' cannot be configured on "
                    f"'{computer}':\n{component.error}"
                )

    def raise_on_unreached(self, incarnations: Iterable[Incarnation]) -> None:
        """Raise RunError when one is on a computer that is out of reach."""
        unreached = self.unreached()
        for incarnation in incarnations:
            if incarnation.computer in unreached:
                raise RunError(unreached[incarnation.computer])

    def _raise_on_refusal(self, incarnations: Collection[Incarnation]) -> None:
        """Raise RunError when an agent refuses what should run there, or it is held."""
        for incarnation in incarnations:
            name = incarnation.component
            if incarnation.goal == "active" and name in self.desired.held:
                raise RunError(self.why_held(name))
        for computer in sorted({incarnation.computer for incarnation in incarnations}):
            if refusal := self.reconciler.refusal(computer):
                raise RunError(refusal)

    def raise_on_crashes(
        self, incarnations: Iterable[Incarnation], before: Numbers
    ) -> None:
        """Raise DoesNotStart when a container has ended `_CRASHES` times since."""
        faults: dict[tuple[str, str], list[tuple[str, Fault]]] = {}
        for computer, fault in faults_after(before, self.current()):
            if not fault.is_over:
                place = computer, fault.container
                faults.setdefault(place, []).append((computer, fault))
        for incarnation in incarnations if faults else ():
            place = self.layout.container_at(incarnation)
            found = self.reported(incarnation)
            is_there = found is not None and found.state != "unconfigured"
            if not is_there and len(same := faults.get(place, ())) >= _CRASHES:
                raise DoesNotStart(incarnation.component, "; ".join(combined(same)))

    def raise_on_lost(self, patience: float = 0.0) -> None:
        """Raise RunError when a computer is out of reach for `patience` [s] or more.

        Unless it goes on without. What is out of reach is in the journal at once.
        """
        if self.goes_on_without_lost:
            return
        now, before, sentences = self.clock.now(), self._away_since, self.unreached()
        self._away_since = {name: before.get(name, now) for name in sentences}
        for computer, sentence in sentences.items():
            if computer not in before:
                self.journal.note("wrong", sentence)
            if now - self._away_since[computer] >= patience:
                raise RunError(sentence)
        for computer in before.keys() - sentences.keys():
            self.journal.note("right", f"computer '{computer}' is reached again")
