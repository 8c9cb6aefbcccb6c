"""The steps of a transition, as a container takes them for its components.

Each is harmless when repeated, and leaves all as it was when it fails. The manager may
have given a step up before it is taken: what comes to rest or is held then goes on when
the deployment says that the move is over, and is refused after that. What each step is
for, and why they come in this order: docs/design/moves.md.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from functools import partial

from poise.errors import PoiseError, RunError, Timeout
from poise.priority import as_usual
from poise.runtime.component.error_report import told_in_brief
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Runners, Transports, Wiring
from poise.runtime.migration.state_receiver import StateReceiver
from poise.runtime.migration.state_sender import StateSender, key_of
from poise.wire.records.migration import (
    Activate,
    Await,
    Done,
    Drain,
    Failed,
    Flush,
    Give,
    Hold,
    Lull,
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

_SHARE = 0.75
"""Steps may take this share of their order's limit: the rest is for the answer, so that
whoever ordered them hears which step was too slow, and of what component."""
_POLL = 0.001
"""A mailbox does not tell when it is empty; look this often [s]."""
_REST_SHARE = 0.8
"""Coming to rest may take this share of that: so those that wait to take over hear why
they cannot before they give up."""


class MigrationExecutor:
    """Takes steps in one container, on any thread."""

    def __init__(
        self, runners: Runners, wiring: Wiring, transports: Transports
    ) -> None:
        self._runners = runners
        self._wiring = wiring
        self._transports = transports
        self._givers: dict[Runner, tuple[str, StateSender]] = {}
        self._heirs: dict[Runner, StateReceiver] = {}
        self._num_deployments = 0

    def note_deployment(self) -> None:
        """Refuse the orders that were heard until now: a deployment says what is so.

        The next move of the same component may follow, and is none of theirs.
        """
        self._num_deployments += 1

    def hear(self, order: Order) -> Callable[[], Outcome]:
        """Return what takes the steps of an order that was heard just now."""
        return partial(self._take_all, order, time.monotonic(), self._num_deployments)

    def _take_all(self, order: Order, heard: float, deployment: int) -> Outcome:
        deadline = heard + _SHARE * order.limit
        seconds: Counter[str] = Counter()
        try:
            for step in order.steps:
                if deployment != self._num_deployments:
                    text = f"{type(step).__name__} is late: a deployment came before it"
                    return Failed(order.number, text)
                began = time.monotonic()
                self._take(step, deadline)
                seconds[type(step).__name__] += time.monotonic() - began  # type: ignore[assignment] # a counter of times
        except PoiseError as error:
            return Failed(order.number, str(error))
        except Exception as error:  # noqa: BLE001, a user's restore may raise anything
            return Failed(order.number, told_in_brief(error))
        return Done(order.number, dict(seconds))

    def _take(self, step: Step, deadline: float) -> None:  # noqa: C901, PLR0912, a table
        match step:
            case Hold(connectors, mark):
                for name in connectors:
                    sender = self._wiring.sender(name)
                    sender.buffer_for_move()
                    sender.send_marker(mark)
            case Release(keys):
                for key in keys:
                    self._wiring.sender_to(key).switch(key)
            case Offer(component, epoch, number):
                self._offer(self._runner(component, epoch), number)
            case Precopy():
                with as_usual():  # a large state takes its time, and nobody waits
                    self._precopy(step, deadline)
            case Await(component, epoch):
                self._state_target(self._runner(component, epoch)).ask()
            case Lull(component, epoch, limit):
                self._runner(component, epoch).wait_lull(min(limit, _left(deadline)))
            case Rest(component, epoch, mark):
                self._rest(self._runner(component, epoch), mark, _left(deadline))
            case Flush(component, epoch, connectors, mark):
                ends = self._runner(component, epoch).endpoints
                ends.wait_markers(dict.fromkeys(connectors, mark), _left(deadline))
            case Drain(component, epoch):
                self._drain(self._runner(component, epoch), deadline)
            case Give(component, epoch):
                self._state_source(self._runner(component, epoch)).give()
            case Take(component, epoch):
                state_target = self._state_target(self._runner(component, epoch))
                state_target.take_over(_left(deadline))
            case Activate(component, epoch):
                self._activate(self._runner(component, epoch), _left(deadline))
            case Open(component, epoch):
                self._open(self._runner(component, epoch))
            case Retire(component, epoch):
                self._runner(component, epoch).exclusion.redirect()

    def _runner(self, component: str, epoch: int) -> Runner:
        try:
            return self._runners[component, epoch]
        except KeyError:
            raise RunError(f"component '{component}' ({epoch}) is not here") from None

    def _state_source(self, runner: Runner) -> StateSender:
        try:
            return self._givers[runner][1]
        except KeyError:
            raise RunError(f"component '{runner.spec.name}' offers nothing") from None

    def _open(self, runner: Runner) -> None:
        runner.aim("active")
        if runner in self._givers:  # it led back
            self._givers[runner][1].refuse("it is at work again")

    def _rest(self, runner: Runner, mark: int, limit: float) -> None:
        try:
            runner.rest(_REST_SHARE * limit)
        except PoiseError as error:
            if runner in self._givers:
                self._givers[runner][1].refuse(str(error))
            raise
        for sender in list(runner.endpoints.senders.values()):
            sender.send_marker(mark)

    def _drain(self, runner: Runner, deadline: float) -> None:
        while not runner.endpoints.is_empty():
            if time.monotonic() > deadline:
                raise Timeout(
                    f"component '{runner.spec.name}' did not work on all that waits"
                )
            time.sleep(_POLL)

    def _offer(self, runner: Runner, number: int) -> None:
        """Let new incarnations fetch; what an earlier exchange offered is over."""
        self._withdraw(runner)
        key = key_of(runner.spec.name, runner.spec.epoch, number)
        state_source = StateSender(runner)
        self._givers[runner] = key, state_source
        self._transports.server.open(key, state_source.handle)

    def _withdraw(self, runner: Runner) -> None:
        if runner in self._givers:
            key, state_source = self._givers.pop(runner)
            state_source.refuse("the offer is withdrawn")
            self._transports.server.shut(key)

    def _precopy(self, step: Precopy, deadline: float) -> None:
        """Join the pipes for the hand-over, and use them already when that helps."""
        runner = self._runner(step.component, step.epoch)
        self._forget_heir(runner)
        state_target = self._heirs[runner] = StateReceiver(
            runner, step, self._transports.channel
        )
        state_target.join(deadline)

    def _state_target(self, runner: Runner) -> StateReceiver:
        try:
            return self._heirs[runner]
        except KeyError:
            raise RunError(f"component '{runner.spec.name}' takes nothing") from None

    def _forget_heir(self, runner: Runner) -> None:
        if runner in self._heirs:
            self._heirs.pop(runner).close()

    def _activate(self, runner: Runner, limit: float) -> None:
        runner.aim("ready")
        if runner.wait_state({"active", "failed"}, limit) != "active":
            error = runner.status().error or f"waited {limit:g} s"
            raise RunError(f"component '{runner.spec.name}' is not activated: {error}")

    def forget(self, runner: Runner) -> None:
        """Know no more of an incarnation that has gone."""
        self._forget_heir(runner)
        self._withdraw(runner)


def _left(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())
