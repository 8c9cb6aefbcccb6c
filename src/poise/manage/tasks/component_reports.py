"""What components say of actions, and what is learned of architectures from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet

from poise.estimate.outcomes import Conditions
from poise.estimate.success_rates import is_tried, learned
from poise.manage.adaptation.decision import shortages_of
from poise.manage.adaptation.situation import Situation
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.live_robot import LiveRobot
from poise.model.check.allowed_computers import pinned_components
from poise.model.phases import first_action, promise_of
from poise.model.robot import Architecture, ConnectorEnd, Robot
from poise.model.steps import Choice
from poise.wire.records.status_records import ActionEnd, ComponentStatus, TaskRequest

_EPOCHS = 3
"""How many incarnations of a component are remembered, the last ones."""


class ComponentReports:
    """Hears what the components of a run say, once."""

    def __init__(self, live: LiveRobot, heard: dict[str, dict[int, int]]) -> None:
        self._live = live
        self._heard = heard  # component -> epoch -> number of the last request heard

    def ends(self) -> Mapping[str, ActionEnd]:
        """Return what was said at each port that ends an action, as component.port."""
        placed, prepared = self._live.placed, self._live.prefetched
        return {
            f"{component.name}.{end.port}": end
            for component in components_of(self._live.agents.statuses())
            if component.ends
            and (known := placed.get(component.name) or prepared.get(component.name))
            and known.epoch == component.epoch
            for end in component.ends
        }

    def requests(self) -> Iterator[tuple[str, TaskRequest]]:
        """Yield what components want done with tasks, and which component does."""
        for component in components_of(self._live.current()):
            for request in self._new_of(component) if component.task_requests else ():
                heard = self._heard.setdefault(component.name, {})
                heard[component.epoch] = request.number
                while len(heard) > _EPOCHS:
                    del heard[min(heard)]
                yield component.name, request

    def _new_of(self, component: ComponentStatus) -> Sequence[TaskRequest]:
        """Return all behind the last one; all, when it was started again since."""
        heard = self._heard.get(component.name, {}).values()  # it may have moved since
        begin = 0
        for index, request in enumerate(component.task_requests, 1):
            if request.number in heard:
                begin = index
        return component.task_requests[begin:]


class Serving:
    """The architectures of a run that are at work."""

    def __init__(self, live: LiveRobot) -> None:
        self._live = live
        self._placed: AbstractSet[str] = frozenset()
        self._whole_then: list[Architecture] = []

    def moving(self) -> list[Architecture]:
        """Return those of the sequencing layer of which something is placed."""
        placed = self._live.placed
        return [
            a
            for a in self._live.robot.architectures
            if a.layer == "sequencing" and any(c.name in placed for c in a.components)
        ]

    def fixed(self) -> set[str]:
        """Return the functions of other layers that run: they never stop."""
        return {a.function for a in self._whole() if a.layer != "sequencing"}

    def functions(self) -> set[str]:
        """Return the functions that some architecture provides wholly."""
        return {a.function for a in self._whole()}

    def broken(self, lost: Collection[str]) -> set[str]:
        """Return the functions of which something is missing, or on a lost computer."""
        placed = self._live.placed
        return {
            a.function
            for a in self.moving()
            for c in a.components
            if c.name not in placed or placed[c.name].computer in lost
        }

    def replaceable(
        self, lost: Collection[str], functions: Collection[str]
    ) -> list[str]:
        """Return placed components that cannot come back, but have an alternative."""
        placed, pinned = self._live.placed, pinned_components(self._live.robot)
        found: list[str] = []
        for here in self.exchangeable(functions):
            if any(placed[name].computer in lost for name in here if name in pinned):
                found += here
        return found

    def exchangeable(self, functions: Collection[str]) -> list[list[str]]:
        """Return the placed components of each architecture that has an alternative."""
        robot, placed = self._live.robot, self._live.placed
        provided = Counter(a.function for a in robot.architectures)
        return [
            [c.name for c in a.components if c.name in placed]
            for a in self.moving()
            if a.function in functions and provided[a.function] > 1
        ]

    def architectures(self, functions: Collection[str]) -> list[str]:
        """Return the names of the architectures that provide functions now."""
        return [a.name for a in self._whole() if a.function in functions]

    def functions_of(self, components: Iterable[str]) -> set[str]:
        """Return the functions that components belong to."""
        architecture_of = self._live.robot.architecture_of
        return {architecture_of(name).function for name in components}

    def why_endless(self, end: ConnectorEnd | None) -> str:
        """Return why nothing can report an action's end; empty: its component runs."""
        if end is None or end.component in self._live.placed:
            return ""
        function = self._live.robot.architecture_of(end.component).function
        if not (serving := self.architectures([function])):
            return ""  # it is suspended, or its computer is lost: it may come back
        return (
            f"'{end}' ends it, but architecture '{serving[0]}' provides '{function}' "
            f"without component '{end.component}'"
        )

    def _whole(self) -> list[Architecture]:
        """Return what is placed wholly; computed when the placed components change."""
        live, placed = self._live, self._live.placed.keys()
        if placed != self._placed:
            self._placed = frozenset(placed)
            self._whole_then = [a for a in live.robot.whole(placed) if a.components]
        return self._whole_then


def choose(
    robot: Robot,
    choice: Choice,
    conditions: Conditions,
    note: Callable[[str], object],
) -> int:
    """Return which step of a choice promises most; of equals the first.

    A step promises what the best architectures for its first action do: their quality
    times their success under these conditions, as learned. Once that is known of one
    step, those that were not tried count as succeeding every other time.
    """
    actions = [first_action(robot, step) for step in choice.steps]
    compares = robot.explore or any(is_tried(robot, a, conditions) for a in actions)
    promises = []
    for action in actions:
        known = learned(robot, [action], conditions=conditions, compares=compares).robot
        promises.append((action.name, promise_of(known, action)))
    best = max(range(len(promises)), key=lambda index: promises[index][1])
    said = ", ".join(f"'{name}' {promise:.0%}" for name, promise in promises)
    note(f"chose '{promises[best][0]}'; expected: {said}")
    return best


def conditions_of(situation: Situation) -> Conditions:
    """Return the conditions of a robot, for which success is learned."""
    return Conditions(
        lost=tuple(situation.lost),
        cpu_is_short=any(short > 0 for short in shortages_of(situation).values()),
    )
