"""What components say of actions and tasks: ends, and wishes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import Struct

from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.running_components import RunningComponents
from poise.wire.records.status import TaskWish


class Heard(Struct, frozen=True):
    """What was said at a port that ends an action: by which epoch, how often, what."""

    epoch: int = 0
    count: int = 0
    done: bool = False


class ComponentReports:
    """Hears what the components of a run say, once."""

    def __init__(self, run: RunningComponents) -> None:
        self._run = run
        self._wishes: dict[tuple[str, int], int] = {}

    def ends(self) -> Mapping[str, Heard]:
        """Return what was said at each port that ends an action, as component.port."""
        placed, prepared = self._run.placed, self._run.prepared
        return {
            f"{each.name}.{end.port}": Heard(each.epoch, end.count, end.done)
            for each in components_of(self._run.current())
            if each.ends
            and (known := placed.get(each.name) or prepared.get(each.name))
            and known.epoch == each.epoch
            for end in each.ends
        }

    def wishes(self) -> Iterator[tuple[str, TaskWish]]:
        """Yield what components want done with tasks, and which component does."""
        for component in components_of(self._run.current()):
            key = component.name, component.epoch
            for wish in component.wishes:
                if wish.number > self._wishes.get(key, 0):
                    self._wishes[key] = wish.number
                    yield component.name, wish
