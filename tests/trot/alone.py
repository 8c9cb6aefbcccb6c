"""Components on their own: every port is played by the test."""

from __future__ import annotations

import types
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, TypeVar

from poise import testing
from poise.clock import ComponentClock
from poise.runtime.component.component import Component, Context, create
from poise.runtime.component.ports import Published, ports_of
from sorter.device import NAMES
from trot.packets import DEVICES

C = TypeVar("C", bound=Component)


class VirtualClock(testing.VirtualClock):
    """A clock that moves when it is told to."""

    @property
    def time(self) -> float:
        return self.now()

    @time.setter
    def time(self, moment: float) -> None:
        self.sleep(moment - self.now())


class Alone(types.SimpleNamespace):
    """A component with nobody around: what it published and what it measured."""

    component: Any
    published: dict[str, list[Any]]
    measured: dict[str, list[float]]


def alone(
    implementation: type[C],
    parameters: Mapping[str, Any] | None = None,
    *,
    clock: ComponentClock | None = None,
    devices: Mapping[str, str] | None = None,
    providers: Mapping[str, object] | None = None,
) -> Alone:
    """Return a configured component; devices that are not given are away."""
    published: dict[str, list[Any]] = defaultdict(list)
    measured: dict[str, list[float]] = defaultdict(list)
    away = {name: f"/nowhere/{name}.sock" for name in (*DEVICES, *NAMES)}
    context = Context(
        name=implementation.__name__,
        parameters=parameters or {},
        devices=away | dict(devices or {}),
        clock=clock or VirtualClock(),
        measure=lambda name, value: measured[name].append(value),
    )
    component = create(implementation, context)
    for port in ports_of(implementation).values():
        if port.kind == "publishes":
            setattr(component, port.name, Published(published[port.name].append))
    for name, provider in (providers or {}).items():
        setattr(component, name, provider)
    component.configure()
    return Alone(component=component, published=published, measured=measured)
