"""What should run on the robot: one frozen record, which `commit` replaces."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from msgspec import Struct, structs
from msgspec.structs import replace

from poise.units import shortened
from poise.wire.records.deployment_records import Goal


class Incarnation(Struct, frozen=True, kw_only=True):
    """A component on a computer. While it moves or is replaced there are two."""

    component: str
    computer: str
    # tells the incarnations of a component apart; the later one has the higher
    epoch: int = 0
    goal: Goal = "active"
    implementation: str = ""  # instead of the robot file's; empty: that one
    # ``package.module:function`` that turns the state of the implementation before into
    # one for this; empty: it is the same
    adapt: str = ""
    fresh: bool = False  # whether it begins without state
    # the version of the code that it runs instead of the robot's; empty: the robot's
    code: str = ""
    gently: bool = False  # whether it is prepared with the CPU time that others leave
    follows: bool = False  # whether its predecessor is at work until it takes over
    # whether it has no connectors yet: the target of a migration that has not begun
    unjoined: bool = False
    # whether it is idle from now on: what it publishes until it rests still goes out
    parting: bool = False
    # whether it has worked, so that it has state when it is idle
    has_worked: bool = False
    held: bool = False  # whether it is inactive only because `Desired.held` names it
    # the actions of tasks that it is to end, the last begun last: number and name
    actions: Mapping[int, str] = {}

    def __str__(self) -> str:
        """Return what it is and where, for the journal."""
        return f"{self.component}/{self.epoch} on {self.computer} ({self.goal})"

    @property
    def key(self) -> tuple[str, int]:
        """Component and epoch, which tell it from all others."""
        return self.component, self.epoch

    def with_goal(self, goal: Goal) -> Incarnation:
        """Return the same with another goal; once active, it has taken over."""
        follows = self.follows and goal != "active"
        return structs.replace(self, goal=goal, follows=follows)


class OtherCode(Struct, frozen=True):
    """What a component runs since it was replaced, also when it begins again."""

    implementation: str  # as of an `Incarnation`
    code: str  # the same
    instead_of: str  # the robot file's implementation then, and the version of its code


class Desired(Struct, frozen=True, kw_only=True):
    """What should run on all computers of a robot."""

    placed: Mapping[str, Incarnation] = {}  # component -> its authoritative incarnation
    # what the change under way brings, beside or instead of what is placed
    coming: tuple[Incarnation, ...] = ()
    # targets of migrations that have not begun: they are configured meanwhile
    configured_ahead: tuple[Incarnation, ...] = ()
    # component -> an idle incarnation, ready for an action that may come
    prefetched: Mapping[str, Incarnation] = {}
    # components that pause until it is known whether they also run elsewhere
    held: frozenset[str] = frozenset()
    # computer -> CPU for what is being prepared there [cores]
    preparation_cpu: Mapping[str, float] = {}
    # component -> its parameters that were set since the start
    parameters: Mapping[str, Mapping[str, Any]] = {}
    # component -> its code, if that is not the robot file's
    other_code: Mapping[str, OtherCode] = {}
    # architecture that crashed wherever it may run -> its code then
    crashed: Mapping[str, str] = {}
    # component that is not placed -> its epoch when it ended
    ended: Mapping[str, int] = {}
    # what may be at work yet, though it is to end: its agent has not said that it has
    left_behind: tuple[Incarnation, ...] = ()
    # what the next manager needs to go on with the tasks; agents keep it
    tasks: bytes = b""
    generation: int = 0
    # whether nothing is to run; the rest of the record then says what ran last
    is_stopped: bool = False

    def incarnations(self) -> tuple[Incarnation, ...]:
        """Return all that should be in some container."""
        if self.is_stopped:
            return ()
        coming = {incarnation.component for incarnation in self.coming}
        idle = _without(self.prefetched, self.placed.keys() | coming).values()
        wanted = (*self.placed.values(), *self.coming, *self.configured_ahead, *idle)
        if not self.held:
            return wanted
        return tuple(
            replace(incarnation, goal="inactive", held=incarnation.goal == "active")
            if incarnation.component in self.held
            else incarnation
            for incarnation in wanted
        )

    def placement(self) -> dict[str, str]:
        """Return component -> computer of what is authoritative."""
        return {name: incarnation.computer for name, incarnation in self.placed.items()}

    def is_over(self, component: str, epoch: int) -> bool:
        """Return whether a later incarnation of what does not run has ended."""
        return epoch < self.ended.get(component, epoch)

    def settled(self) -> dict[str, Incarnation]:
        """Return the components that no change is about."""
        changing = {incarnation.component for incarnation in self.coming}
        return {
            name: incarnation
            for name, incarnation in self.placed.items()
            if incarnation.goal == "active" and name not in changing | self.held
        }

    def with_coming(self, coming: Iterable[Incarnation]) -> Desired:
        """Return this with another change under way, or none; it is ahead no more."""
        coming = tuple(coming)
        return replace(self.without_configured_ahead(coming), coming=coming)

    def with_configured_ahead(self, targets: Iterable[Incarnation]) -> Desired:
        """Return this with targets of a migration to come."""
        return replace(self, configured_ahead=(*self.configured_ahead, *targets))

    def without_configured_ahead(self, targets: Iterable[Incarnation]) -> Desired:
        """Return this without targets of a migration that begins, or never will."""
        keys = {incarnation.key for incarnation in targets}
        left = (each for each in self.configured_ahead if each.key not in keys)
        return replace(self, configured_ahead=tuple(left))

    def placing(self, incarnations: Iterable[Incarnation]) -> Desired:
        """Return this with incarnations that are authoritative from now on."""
        new = {incarnation.component: incarnation for incarnation in incarnations}
        return replace(
            self,
            placed={**self.placed, **new},
            prefetched=_without(self.prefetched, new),
            coming=(),
        )

    def without(self, components: Collection[str]) -> Desired:
        """Return this without components, whatever they do."""
        return replace(
            self,
            placed=_without(self.placed, components),
            prefetched=_without(self.prefetched, components),
            coming=tuple(e for e in self.coming if e.component not in components),
        )

    def with_prefetched(self, incarnations: Iterable[Incarnation]) -> Desired:
        """Return this with incarnations that are idle from now on."""
        new = {incarnation.component: incarnation for incarnation in incarnations}
        return replace(self, prefetched={**self.prefetched, **new})

    def parted(self) -> Desired:
        """Return this with connectors to nothing that is idle."""
        idle = {
            name: replace(each, unjoined=True, parting=False) if each.parting else each
            for name, each in self.prefetched.items()
        }
        return replace(self, prefetched=idle)

    def aiming(self, goal: Goal, components: Collection[str]) -> Desired:
        """Return this with another goal for placed components."""
        placed = {
            name: incarnation.with_goal(goal) if name in components else incarnation
            for name, incarnation in self.placed.items()
        }
        return replace(self, placed=placed)

    def with_parameters(self, component: str, changes: Mapping[str, Any]) -> Desired:
        """Return this with other values of some parameters of a component."""
        values = {**self.parameters.get(component, {}), **changes}
        return replace(self, parameters={**self.parameters, component: values})

    def released(self) -> Desired:
        """Return this without any change under way: what was placed goes on."""
        return replace(
            self.aiming("active", self.placed.keys()), coming=(), configured_ahead=()
        )


def _without(
    incarnations: Mapping[str, Incarnation], names: Collection[str]
) -> dict[str, Incarnation]:
    return {name: each for name, each in incarnations.items() if name not in names}


def difference(before: Desired, after: Desired) -> list[str]:
    """Return what a commit changes, one entry for each incarnation."""
    if before.is_stopped != after.is_stopped:
        return ["nothing is to run" if after.is_stopped else "all is to run"]
    old, new = (
        {incarnation.key: incarnation for incarnation in record.incarnations()}
        for record in (before, after)
    )
    gone = (f"- {incarnation}" for key, incarnation in old.items() if key not in new)
    come = (f"+ {incarnation}" for key, incarnation in new.items() if key not in old)
    aims = (
        f"{old[key]} -> {incarnation.goal}"
        for key, incarnation in new.items()
        if key in old and old[key].goal != incarnation.goal
    )
    values = (
        f"parameters of {name}: {_in_words(changed)}"
        for name, changed in after.parameters.items()
        if changed != before.parameters.get(name, {})
    )
    return [*gone, *come, *aims, *values]


def _in_words(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {shortened(repr(each))}" for key, each in values.items())
