"""Journals errors of components' code: when they begin, and when they end."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping

from poise.clock import wall_time
from poise.manage.agent_connections.statuses import Statuses
from poise.manage.journal import Kind
from poise.manage.observe.deviations import Deviation
from poise.units import counted
from poise.wire.records.status import ComponentStatus, ContainerStatus

QUIET = 10.0
"""Errors of one kind are over when none came for so long [s]."""
_MOST = 10
"""So many incarnations of a component are told apart; two are there in a move."""
_Counts = Mapping[str, tuple[int, Deviation]]
"""Kind of error -> how often, and the first one."""


class CodeErrors:
    """Tells what goes wrong now from what did before: errors, and messages refused.

    A component that failed is a deviation, and not told of here.

    Parameters
    ----------
    note
        Takes entries of the journal.
    """

    def __init__(self, note: Callable[[Kind, str], object]) -> None:
        self._note = note
        self._counts: dict[str, dict[Hashable, _Counts]] = {}
        """Component or connector -> incarnation -> what was counted."""
        self._coming: dict[tuple[str, str], tuple[Deviation, int, float]] = {}
        """What goes wrong now, how often it did so, and when it did last."""

    def look(self, statuses: Statuses, now: float) -> None:
        """Note what is new in `statuses`, and what came no more until `now` [s]."""
        for computer, status in statuses.items():
            for container in status.containers:
                for component in container.components:
                    stay = container.pid, component.epoch
                    self._take(component.name, stay, _raised(component, computer), now)
                for name, count in refused(container):
                    error = Deviation(
                        what=f"connector '{name}' refused messages on '{computer}': "
                        "not of the port's type; `poise log` says more",
                        computer=computer,
                        since=wall_time(),
                    )
                    self._take(name, container.pid, {"": (count, error)}, now)
        for key, (error, count, last) in list(self._coming.items()):
            if now - last >= QUIET:
                del self._coming[key]
                self._note("right", f"{error.end()} ({counted(count, 'time')})")

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what goes wrong now."""
        return tuple(error for error, _, _ in self._coming.values())

    def _take(self, name: str, stay: Hashable, counts: _Counts, now: float) -> None:
        known = self._counts.setdefault(name, {})
        before = known.pop(stay, {})
        for kind, (count, error) in counts.items():
            earlier = before[kind][0] if kind in before else 0
            # an end of a connector may begin again in the same process
            new = count - earlier if count >= earlier else count
            if new and (name, kind) not in self._coming:
                self._note("wrong", error.what)
            if new:
                first, so_far, _ = self._coming.get((name, kind), (error, 0, now))
                self._coming[name, kind] = first, so_far + new, now
        known[stay] = counts
        if len(known) > _MOST:
            del known[next(iter(known))]


def _raised(component: ComponentStatus, computer: str) -> _Counts:
    found: dict[str, tuple[int, Deviation]] = {}
    name = component.name
    for error in component.error_counts if component.state != "failed" else ():
        text = error.text.rstrip().rpartition("\n")[2]
        handler = f"'{error.where}' of component '{name}' on '{computer}'"
        said = Deviation(
            what=f"{handler} raised {text}; `poise log {name}` says more",
            computer=computer,
            since=error.first,
        )
        kind = f"{error.where} {text.partition(':')[0]}"
        count, said = found.get(kind, (0, said))
        found[kind] = count + error.count, said
    return found


def refused(container: ContainerStatus) -> Iterator[tuple[str, int]]:
    """Yield connectors whose targets refused messages, and how many.

    A call that fails is an error of its caller, who may expect it.
    """
    failing = [e for e in container.connectors if e.errors and e.end != "source"]
    if not failing:
        return
    topics = tuple(
        f"-{component.name}.{port}"
        for component in container.components
        for port in component.subscribes
    )
    for end in failing:
        if end.name.endswith(topics):
            yield end.name, end.errors
