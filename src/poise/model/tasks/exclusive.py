"""What only one action may use at a time: exclusive devices and functions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal

from msgspec import Struct

from poise.model.robot import Architecture, Robot
from poise.model.tasks.steps import Action


class Clash(Struct, frozen=True, kw_only=True):
    """An exclusive device or function that several would use at the same time."""

    kind: Literal["device", "function"]
    name: str
    # for a function the actions that need it; for a device ``function of action``
    users: tuple[str, ...]

    def __str__(self) -> str:
        users = " and ".join(self.users)
        return (
            f"{users} would use the {self.kind} '{self.name}' at the same time, which "
            "is exclusive"
        )


def clashes(robot: Robot, actions: Iterable[Action]) -> Iterator[Clash]:
    """Yield what actions that run at once cannot share.

    Of a function with alternatives, only devices that all of them need count: the
    others can be avoided.
    """
    actions = tuple(actions)
    exclusive = {a.function for a in robot.architectures if a.exclusive}
    for function in sorted(exclusive):
        users = tuple(f"'{a.name}'" for a in actions if function in a.functions)
        if len(users) > 1:
            yield Clash(kind="function", name=function, users=users)
    pairs = [(a.name, f) for a in actions for f in dict.fromkeys(a.functions)]
    for device in robot.devices:
        if not device.exclusive:
            continue
        users = tuple(
            f"'{function}' of '{action}'"
            for action, function in pairs
            if _always_needs(robot, function, device.name)
        )
        if len(users) > 1:
            yield Clash(kind="device", name=device.name, users=users)


def needs_device(architecture: Architecture, device: str) -> bool:
    """Return whether some component of an architecture needs a device."""
    return any(device in each.devices for each in architecture.components)


def _always_needs(robot: Robot, function: str, device: str) -> bool:
    every = [a for a in robot.architectures if a.function == function]
    return bool(every) and all(needs_device(each, device) for each in every)
