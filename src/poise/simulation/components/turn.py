"""One run of a handler: it asks others, works, and sends what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

from poise.simulation.components.channels import Incoming, SimulatedSender
from poise.simulation.components.models import HandlerModel

if TYPE_CHECKING:
    from poise.simulation.components.component import SimulatedComponent


class Turn:
    """A handler of a component, from its begin to its end.

    Parameters
    ----------
    name
        Of the timer or slot.
    item
        The message or call that it handles; None: a timer was due.

    Attributes
    ----------
    then
        Called at its end.
    """

    __slots__ = (
        "_component",
        "_cost",
        "_handler",
        "_item",
        "_name",
        "_to_ask",
        "_token",
        "then",
    )

    def __init__(
        self,
        component: SimulatedComponent,
        name: str,
        handler: HandlerModel,
        item: Incoming | None = None,
    ) -> None:
        self._component = component
        self._name = name
        self._handler = handler
        self._item = item
        self._to_ask: Iterator[SimulatedSender] = iter(())
        self._token = 0
        self._cost = 0.0
        self.then: Callable[[], object] | None = None

    def begin(self) -> None:
        """Take the data, and ask others for what it needs."""
        component, item = self._component, self._item
        ledger = component.container.world.ledger
        ledger.begin(component.who, component.container.world.scheduler.now)
        if component.ages:
            component.ages.begin()
        if item is not None:
            if item.number:
                ledger.process(item.slot, item.number, component.who)
            if item.stamps:
                component.ages.take(item.spec.carries, item.stamps)
        if self._handler.calls:
            self._to_ask = iter(self._senders(self._handler.calls))
        self._ask_next()

    def _ask_next(self) -> None:
        """Call the next one, or work when all have answered."""
        sender = next(self._to_ask, None)
        if sender is None:
            self._work()
            return
        self._token += 1
        token = self._token
        sender.call(lambda stamps: self._answered(sender, token, stamps))

    def _answered(
        self, sender: SimulatedSender, token: int, stamps: tuple[float, ...] | None
    ) -> None:
        component = self._component
        if token != self._token or component.turn is not self:
            return  # it came after its limit
        self._token += 1
        if stamps and component.ages:
            component.ages.take(sender.spec.answers, stamps)
        self._ask_next()

    def _work(self) -> None:
        component, item = self._component, self._item
        container = component.container
        world = container.world
        work = self._handler.draw(world.choices)
        work *= component.model.factor(world.scheduler.now)
        if item is not None:
            work += container.cost_of(item.spec, "target")
        self._cost = work
        container.cpu.run(work, self._worked)

    def _worked(self) -> None:
        component = self._component
        container, ledger = component.container, component.container.world.ledger
        now = container.world.scheduler.now
        component.cpu += self._cost
        ledger.end(component.who, container.process.awake_since, now)
        item, handler = self._item, self._handler
        may_work = container.may_work(component.spec)
        if handler.publishes != {} and may_work:
            ledger.act(component.who, now)
            for sender in self._targets():
                sender.publish()
        if item is not None and item.answer is not None and may_work:
            answers = item.spec.answers
            item.answer(component.ages.stamps(answers) if answers else ())
        if component.ages:
            component.ages.end(is_timer=item is None)
        if self.then is not None:
            self.then()
        component.end_turn()

    def _targets(self) -> list[SimulatedSender]:
        publishes = self._handler.publishes
        if publishes is None:
            return self._component.container.senders_of(self._component)
        return self._senders(publishes)

    def _senders(self, wanted: Mapping[str, float]) -> list[SimulatedSender]:
        """Return whom it sends to in this run; fractions add up over the runs."""
        component, found = self._component, []
        for slot, each in wanted.items():
            key = self._name, slot
            credit = component.credit.get(key, 0.5) + each
            times = int(credit)
            component.credit[key] = credit - times
            if times:
                sender = component.container.sender_of(component, slot)
                if sender is not None:
                    found += [sender] * times
        return found
