"""The steps of a transition, as a container takes them for its components.

Each is harmless when repeated, and leaves all as it was when it fails. The manager may
have given a step up before it is taken: what comes to rest or is held then goes on when
the deployment says that the move is over, and is refused after that. What each step is
for, and why they come in this order: docs/design/moves.md.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

from poise.errors import PoiseError, RunError, Timeout
from poise.runtime import handover
from poise.runtime.connectors.outlet import Outlet
from poise.runtime.handover import Ask, Giver
from poise.runtime.implementation import find_function
from poise.runtime.runner import Runner
from poise.runtime.wiring import Runners, Transports, Wiring
from poise.wire.messages import (
    Activate,
    Done,
    Failed,
    Flush,
    Hold,
    Offer,
    Open,
    Order,
    Outcome,
    Precopy,
    Release,
    Rest,
    Retire,
    Step,
    Take,
)
from poise.wire.pipe import Pipe

_POLL = 0.001
"""zenoh tells of a new peer without a wake-up; look this often [s]."""


class Steps:
    """Takes steps in one container, on any thread."""

    def __init__(
        self, runners: Runners, wiring: Wiring, transports: Transports
    ) -> None:
        self._runners = runners
        self._wiring = wiring
        self._transports = transports
        self._offered: dict[Runner, str] = {}
        self._pipes: dict[Runner, Pipe] = {}

    def take(self, order: Order) -> Outcome:
        """Take one step and tell what came of it."""
        started = time.monotonic()
        numbers: dict[str, int] = {}
        try:
            for step in order.steps:
                numbers |= self._take(step) or {}
        except PoiseError as error:
            return Failed(order.number, str(error))
        except Exception as error:  # noqa: BLE001, a user's restore may raise anything
            return Failed(order.number, f"{type(error).__qualname__}: {error}")
        return Done(order.number, numbers, time.monotonic() - started)

    def _take(self, step: Step) -> dict[str, int] | None:  # noqa: C901, a table
        match step:
            case Hold(connectors, mark):
                outlets = [self._wiring.outlet(name) for name in connectors]
                for outlet in outlets:
                    outlet.hold()
                return marks_of(outlets, mark)
            case Release(keys):
                for key in keys:
                    self._wiring.outlet(key.rpartition("/")[0]).release(key)
            case Offer(component, epoch, new):
                key = handover.key_of(component, epoch, new)
                self._offer(self._runner(component, epoch), key)
            case Precopy(component, epoch, old, limit):
                self._precopy(component, epoch, old, limit)
            case Rest(component, epoch, mark, limit):
                runner = self._runner(component, epoch)
                runner.rest(limit)
                return marks_of(list(runner.ends.outlets.values()), mark)
            case Flush(component, epoch, received, limit):
                runner = self._runner(component, epoch)
                runner.ends.wait_marks(received, limit)
            case Take(component, epoch, old, limit):
                self._fetch(component, epoch, old, Ask.ALL, limit)
            case Activate(component, epoch, limit):
                self._activate(self._runner(component, epoch), limit)
            case Open(component, epoch):
                self._runner(component, epoch).aim("active")
            case Retire(component, epoch):
                self._runner(component, epoch).turn.retire()
        return None

    def _runner(self, component: str, epoch: int) -> Runner:
        try:
            return self._runners[component, epoch]
        except KeyError:
            raise RunError(f"component '{component}' ({epoch}) is not here") from None

    def _offer(self, runner: Runner, key: str) -> None:
        """Let one incarnation fetch; what an earlier move offered is over."""
        server = self._transports.remote_server()
        if runner in self._offered:
            server.shut(self._offered[runner])
        self._offered[runner] = key
        server.open(key, Giver(runner).handle)

    def _precopy(self, component: str, epoch: int, old: int, limit: float) -> None:
        """Join the pipe for the hand-over, and use it already when that helps."""
        runner = self._runner(component, epoch)
        pipe = self._pipe(runner, old, limit)
        deadline = time.monotonic() + limit
        while not pipe.is_ready():
            if time.monotonic() > deadline:
                raise Timeout(f"component '{component}' ({old}) cannot be reached")
            time.sleep(_POLL)
        if handover.offers_delta(runner.component):
            self._fetch(component, epoch, old, Ask.STATE, limit)

    def _fetch(
        self, component: str, epoch: int, old: int, ask: Ask, limit: float
    ) -> None:
        runner = self._runner(component, epoch)
        given = handover.fetch(self._pipe(runner, old, limit), ask, limit)
        adapt = runner.spec.adapt
        handover.take(runner, given, find_function(adapt) if adapt else None)
        if ask is Ask.ALL:
            self._pipes.pop(runner).close()

    def _pipe(self, runner: Runner, old: int, limit: float) -> Pipe:
        if runner not in self._pipes:
            key = handover.key_of(runner.spec.name, old, runner.spec.epoch)
            self._pipes[runner] = self._transports.remote_pipe(key, limit)
        return self._pipes[runner]

    def _activate(self, runner: Runner, limit: float) -> None:
        runner.aim("ready")
        if runner.wait_state({"active", "failed"}, limit) != "active":
            error = runner.status().error or f"waited {limit:g} s"
            raise RunError(f"component '{runner.spec.name}' is not activated: {error}")

    def forget(self, runner: Runner) -> None:
        """Know no more of an incarnation that has gone."""
        if runner in self._pipes:
            self._pipes.pop(runner).close()
        if runner in self._offered:
            self._transports.remote_server().shut(self._offered.pop(runner))


def marks_of(outlets: Iterable[Outlet], mark: int) -> dict[str, int]:
    """Send a mark over each; return it for the connectors where somebody is."""
    return {outlet.name: mark for outlet in outlets if outlet.mark(mark)}
