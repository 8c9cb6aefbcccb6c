"""What a simulated component does: its handlers, their work, what they send and ask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from random import Random
from typing import Literal

from msgspec import Struct

from poise.estimate.profiles import ConnectorProfile, KindCosts
from poise.runtime.component.ports import Timer
from poise.runtime.execution.timers import release_offset
from poise.simulation._engine import Connector, Engine, Handler, Model
from poise.simulation.choices import Choices
from poise.wire.records.deployment_records import ConnectorSpec


class HandlerModel(Struct, frozen=True, kw_only=True):
    """What one run of a handler costs and does.

    `work`: mean [core-seconds of the reference].
    `spread`: standard deviation of its logarithm: it is drawn log-normally. 0: it is
    always the same.
    `waiting`: the share of runs that wait for something else than CPU and calls, such
    as a device; `wait`: for how long, the median [s]. `wait_spread`: as `spread`, of
    that.
    `publishes`: slot of a connector -> messages for each run, on average; None: one
    over each.
    `calls`: slot of a connector -> calls in each run, on average: one after another.
    `joined`, `started`: as `calls`, of those that it starts at once: it waits for all,
    or goes on.
    """

    work: float
    spread: float = 0.0
    waiting: float = 0.0
    wait: float = 0.0
    wait_spread: float = 0.0
    publishes: Mapping[str, float] | None = {}
    calls: Mapping[str, float] = {}
    joined: Mapping[str, float] = {}
    started: Mapping[str, float] = {}

    def made_in(self, engine: Engine) -> Handler:
        """Return it as the engine has it."""
        publishes, calls = self.publishes, list(self.calls.items())
        sent = None if publishes is None else list(publishes.items())
        return engine.handler(
            self.work,
            self.spread,
            sent,
            calls,
            waiting=self.waiting,
            wait=self.wait,
            wait_spread=self.wait_spread,
            joined=list(self.joined.items()),
            started=list(self.started.items()),
        )


class TimerModel(Struct, frozen=True, kw_only=True):
    """A timer, and what it does when it is due."""

    timer: Timer
    handler: HandlerModel


_TICK = TimerModel(
    timer=Timer("tick", 0.1),
    handler=HandlerModel(work=0.005, spread=0.5, publishes=None),
)
_TAKE = HandlerModel(work=0.005, spread=0.5)


class ComponentModel(Struct, frozen=True, kw_only=True):
    """A component, as far as placement, leases and moves are concerned.

    `takes`, `serves`: slot of a connector -> what a message or a call that comes over
    it costs; the others cost what `other` says.
    `answer`: what the answer of a started call costs; None: nothing takes it.
    `factors`: how much dearer handlers are in each second than on average, again and
    again; empty: always the same.
    `keep`: slots that lead to one port, and how many messages wait there at most, the
    oldest of them make room; each other slot has room for `MOST_KEPT`.
    `start`, `start_later`: shortest and longest time until it is configured [s], in a
    container that is started for it and in one that runs already.
    `activate`: longest time that `activate` or `deactivate` takes [s].
    `state_size`: of its snapshot [bytes].
    `memory`: that it needs [bytes].
    `follows_device`: its timers wait for a device, so they keep its phase, whatever
    that is in a run.
    `ends`: the ports at which it says now and then that an action is over.
    """

    timers: tuple[TimerModel, ...] = (_TICK,)
    takes: Mapping[str, HandlerModel] = {}
    serves: Mapping[str, HandlerModel] = {}
    other: HandlerModel = _TAKE
    answer: HandlerModel | None = None
    factors: tuple[float, ...] = ()
    keep: Sequence[tuple[Sequence[str], int]] = ()
    start: tuple[float, float] = (0.02, 0.2)
    start_later: tuple[float, float] = (0.02, 0.1)
    activate: float = 0.01
    state_size: float = 10_000
    memory: float = 10e6
    follows_device: bool = False
    ends: tuple[str, ...] = ()

    def made_in(self, engine: Engine, component: str, random: Random) -> Model:
        """Return it as the engine has it; `random` draws the phase of a device."""
        offset = random.random() if self.follows_device else release_offset(component)
        return engine.model(
            timers=[
                (
                    timer.timer.name,
                    timer.timer.period,
                    timer.timer.deadline,
                    timer.handler.made_in(engine),
                )
                for timer in self.timers
            ],
            takes={
                slot: handler.made_in(engine) for slot, handler in self.takes.items()
            },
            serves={
                slot: handler.made_in(engine) for slot, handler in self.serves.items()
            },
            other=self.other.made_in(engine),
            factors=self.factors,
            keep=self.keep,
            keep_other=MOST_KEPT,
            release_offset=offset,
            answer=self.answer.made_in(engine) if self.answer else None,
        )


MOST_KEPT = 50
"""Messages of one connector that wait for a component, unless it says otherwise."""
Flaw = Literal["fails", "crashes"]
"""What is wrong with code: it cannot be configured, or it crashes soon after."""
Models = Mapping[str, ComponentModel]
"""Component -> its model; those that are not named have the default one."""


def drawn(choices: Choices, limits: tuple[float, float]) -> float:
    """Return a time from the shortest to the longest [s]."""
    return choices.between("components", *limits)


End = Literal["source", "target"]
SIZE = 200.0
"""Of a message whose connector does not say it [bytes]."""


class Traffic(Struct, frozen=True, kw_only=True):
    """What goes over the connectors of a robot.

    `sizes`: connector -> size of a message, or of a call both ways [bytes].
    `calling`: the connectors over which calls go.
    `costs`: kind of connector -> what it costs, as `poise calibrate` measures it.
    """

    sizes: Mapping[str, float] = {}
    calling: frozenset[str] = frozenset()
    costs: Mapping[str, KindCosts] = {}

    def cost(self, connector: str, kind: str, together: str, end: End) -> float:
        """Return the work of one message or call beyond what it costs together."""
        is_call = connector in self.calling
        one = ConnectorProfile(
            calls=float(is_call),
            messages=float(not is_call),
            size=self.sizes.get(connector, 0.0),
        )
        now, then = (
            getattr(self.costs.get(between, KindCosts()), end).load(one)
            for between in (kind, together)
        )
        return max(0.0, float(now - then))

    def apart(self, connector: str, together: str) -> float:
        """Return what both ends work more for a message or call when they are apart."""
        return self.cost(connector, "remote", together, "source") + self.cost(
            connector, "remote", together, "target"
        )

    def size_of(self, connector: str) -> float:
        """Return the size of a message, or of a call both ways [bytes]."""
        return self.sizes.get(connector, SIZE)

    def connector_in(
        self, engine: Engine, spec: ConnectorSpec, together: str
    ) -> Connector:
        """Return a connector as the engine has it; `together` as for `cost`."""
        return engine.connector(
            name=spec.name,
            key=spec.key,
            slot=spec.slot or spec.name,
            source=(spec.source, spec.source_epoch),
            target=(spec.target, spec.target_epoch),
            computer=spec.target_computer,
            is_direct=spec.kind == "direct",
            limit=spec.limit,
            size=self.size_of(spec.name),
            costs=(
                self.cost(spec.name, spec.kind, together, "source"),
                self.cost(spec.name, spec.kind, together, "target"),
            ),
            carries=spec.carries,
            answers=spec.answers,
        )
