"""A component's state and goal, and the hooks that lead from one to the other."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from collections.abc import Set as AbstractSet

from poise.runtime.component.component import Verb
from poise.wire.records.deployment_records import Aim
from poise.wire.records.status_records import ActionEnd, State, TaskWish

ENDED: AbstractSet[State] = {"finalized", "failed"}


class LifeCycle:
    """Where a component is, and where it should be; any thread may ask."""

    def __init__(self) -> None:
        self._state: State = "unconfigured"
        self._goal: Aim = "inactive"
        self._changed = threading.Condition()

    @property
    def state(self) -> State:
        """Where it is."""
        return self._state

    @property
    def goal(self) -> Aim:
        """Where it should be."""
        return self._goal

    @property
    def is_at_work(self) -> bool:
        """Whether it is active, and should be."""
        return (self._state, self._goal) == ("active", "active")

    def aim(self, goal: Aim) -> None:
        """Set the goal; in vain after `finalized`."""
        with self._changed:
            if self._goal != "finalized":
                self._goal = goal
            self._changed.notify_all()

    def enter(self, state: State) -> None:
        """Set the state."""
        with self._changed:
            self._state = state
            self._changed.notify_all()

    def next_step(self) -> tuple[str, State] | None:
        """Return the hook to call and the state it leads to; None at the goal."""
        match self._state, self._goal:
            case "unconfigured", "inactive" | "ready" | "active":
                return "configure", "inactive"
            case "inactive", "ready" | "active":
                return "activate", "active"
            case "active", "inactive" | "finalized":
                return "deactivate", "inactive"
            case "inactive" | "unconfigured", "finalized":
                return "cleanup", "finalized"
        return None

    def wait_for_step(self) -> None:
        """Wait until there is something to do: this is how a component idles."""
        with self._changed:
            self._changed.wait_for(lambda: self.next_step() or self._goal == "active")

    def wait_while_active(self, limit: float) -> None:
        """Wait up to `limit` [s] for another goal than ``active``."""
        with self._changed:
            self._changed.wait_for(lambda: self._goal != "active", limit)

    def wait_state(self, states: AbstractSet[State], limit: float) -> State:
        """Wait up to `limit` [s] for one of `states`; return the state then."""
        with self._changed:
            self._changed.wait_for(lambda: self._state in states, limit)
            return self._state


_MOST_WISHES = 16
"""So many wishes are told again and again, in case nobody heard them."""


class TaskNews:
    """What one component wishes to be done with tasks, and which actions have ended."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._wishes: deque[TaskWish] = deque(maxlen=_MOST_WISHES)
        self._num_wishes = 0
        self._ends: dict[str, ActionEnd] = {}

    def wish(self, verb: Verb, task: str) -> None:
        """Wish that something is done with a task."""
        self._num_wishes += 1
        wish = TaskWish(number=self._num_wishes, verb=verb, task=task)
        self._wishes.append(wish)
        self._on_change()

    def note_end(self, port: str, done: object) -> None:
        """Note that the action of a port is done, or has failed."""
        before = self._ends.get(port)
        count = before.count + 1 if before else 1
        self._ends[port] = ActionEnd(port=port, count=count, done=bool(done))
        self._on_change()

    def wishes(self) -> tuple[TaskWish, ...]:
        """Return the latest, oldest first; any thread may ask."""
        return tuple(self._wishes.copy())

    def ends(self) -> tuple[ActionEnd, ...]:
        """Return the last end at each port; any thread may ask."""
        return tuple(self._ends.copy().values())
