"""The protocol of a move as a model: every order in which things can happen.

One component is moved, or two neighbours at once, each from a container ``old`` to a
container ``new``. A source publishes to the first and has callers there; what a
component gets, it publishes to the next, and the last to a sink. Calls go from one to
the other, too. The names of the steps
are those of `MigrationCoordinator` and `MigrationExecutor`, and what
they use.

The manager may give a round of orders up at any time, and does so when one fails: what
was not answered is lost, or is still taken at any moment after that. Any container may
be killed at any moment, and is started anew with what its agent was told last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from tests.model_of_moves.calls import SIDES, Calls
from tests.model_of_moves.faults import Faults
from tests.model_of_moves.world import MARK, Bounds, Incarnation, Order, Side, State

Taken = tuple[State, bool]
"""The state after a step, and whether the step succeeded."""


def initial(bounds: Bounds, bug: str = "") -> State:
    """Return the state after `Exchange._prepare`."""
    count = bounds.movers
    nothing = ((),) * (count + 1)
    return State(
        olds=(Incarnation("work", stays=True),) * count,
        news=(Incarnation("inactive"),) * count,
        to_olds=nothing,
        to_news=nothing,
        orders=hand_over(bounds, bug)[0],
        calls=(("begins", ""),) * len(bounds.callers),
    )


def hand_over(bounds: Bounds, bug: str) -> list[tuple[Order, ...]]:
    """Return the rounds of `Rounds.hand_over`: callers come to rest before callees."""
    movers = range(bounds.movers)
    levels = [list(movers)] if bug == "rest at once" else bounds.levels()
    rounds: list[tuple[Order, ...]] = []
    for level in levels:
        resting = {k: ("Rest",) if k in level else () for k in movers}
        last = len(rounds) == len(levels) - 1
        steps = {"source": () if rounds else ("Hold",), "sink": ("Flush",) * last}
        steps |= {f"old {k}": resting[k] + ("Flush, Give",) * last for k in movers}
        steps |= {f"new {k}": ("Take", "Activate") * last for k in movers}
        rounds.append(_orders(steps))
    return rounds


def opening(side: Side, bounds: Bounds) -> tuple[Order, ...]:
    """Return the round of `Rounds.keep`, or of `Rounds.back`."""
    movers = range(bounds.movers)
    steps: dict[str, tuple[str, ...]] = {f"{side} {k}": ("Open",) for k in movers}
    steps["source"] = (f"Release to {side}",)
    if side == "new":
        steps |= {f"old {k}": ("Retire",) for k in movers}
    return _orders(steps)


def _orders(steps: Mapping[str, tuple[str, ...]]) -> tuple[Order, ...]:
    return tuple(Order(name, todo) for name, todo in steps.items() if todo)


class Protocol:
    """The model's steps.

    Parameters
    ----------
    bug
        Something that is done wrong on purpose, to see that it is found.
    """

    def __init__(self, bounds: Bounds, bug: str = "") -> None:
        self._bounds = bounds
        self._bug = bug
        self._rounds = hand_over(bounds, bug)
        self._calls = Calls(bounds, bug)
        self._faults = Faults(bounds, bug)

    def successors(self, s: State) -> Iterator[tuple[str, State]]:
        """Yield all that may happen next."""
        yield from self._manager(s)
        for order in s.orders:
            if order.outcome == "sent":
                for taken, is_done in self._take(s, order, is_late=False):
                    after = _after(order, is_done=is_done)
                    orders = tuple(after if o == order else o for o in s.orders)
                    yield _said(order), taken._replace(orders=orders)
        for order in s.late:
            for taken, is_done in self._take(s, order, is_late=True):
                after = _after(order, is_done=is_done)
                going_on = {after} if after.outcome == "sent" else set()
                late = (s.late - {order}) | going_on
                yield f"{_said(order)} (late)", taken._replace(late=late)
        yield from self._streams(s)
        yield from self._work(s)
        yield from self._calls.successors(s)
        yield from self._deployments(s)
        yield from self._faults.successors(s)

    # poise.manage.migration.coordinator.Exchange

    def _manager(self, s: State) -> Iterator[tuple[str, State]]:
        if s.round in {"remove", "end"}:
            gone = s.all_of("old" if s.spec == "new" else "new")
            if s.round == "remove" and all(o.phase in {"gone", "dead"} for o in gone):
                yield "removed", s._replace(round="end")
            return
        outcomes = {order.outcome for order in s.orders}
        pending = "sent" in outcomes
        is_handing_over = s.round.startswith("hand over")
        if outcomes == {"done"}:
            yield f"{s.round} is done", self._next(s, failed=False)
        elif "failed" in outcomes and (is_handing_over or not pending):
            yield f"{s.round} failed", self._next(_late(s), failed=True)
        elif pending and s.given_up < self._bounds.gives_up:
            s = s._replace(given_up=s.given_up + 1)
            yield f"{s.round} is given up", self._next(s, failed=True)
            if self._bounds.late:
                yield f"{s.round} is late", self._next(_late(s), failed=True)

    def _next(self, s: State, *, failed: bool) -> State:
        if s.round in {"keep", "back"}:
            spec = "new" if s.round == "keep" else "old"
            return s._replace(round="remove", orders=(), spec=spec)
        if failed and self._bug != "ignore failures":
            return s._replace(round="back", orders=opening("old", self._bounds))
        following = int(s.round.rpartition(" ")[2]) + 1
        if following < len(self._rounds) and not failed:
            orders = self._rounds[following]
            return s._replace(round=f"hand over {following}", orders=orders)
        return s._replace(round="keep", orders=opening("new", self._bounds))

    # poise.runtime.migration.executor.Steps

    def _take(self, s: State, order: Order, *, is_late: bool) -> Iterator[Taken]:
        """Yield the states after the next step of an order; nothing: it waits."""
        kind, _, which = order.container.partition(" ")
        step = order.steps[0]
        if kind == "source":
            if not s.is_source_dead:
                yield self._at_source(s, step), True
        elif kind == "sink":
            yield from self._flush(s, is_marked=s.is_sink_marked, is_late=is_late)
        elif kind == "old":
            yield from self._at_old(s, int(which), step, is_late=is_late)
        else:
            yield from self._at_new(s, int(which), step, is_late=is_late)

    def _flush(self, s: State, *, is_marked: bool, is_late: bool) -> Iterator[Taken]:
        """`Ends.wait_marks`; its limit matters when a killed one had the mark."""
        if is_marked or self._bug == "no flush":
            yield s, True
        elif s.kills or is_late:
            yield s, False

    def _at_source(self, s: State, step: str) -> State:
        """`Sender.hold`, `Sender.mark`, `Sender.release`."""
        if step == "Hold":
            if s.applied != "both" and self._bug != "hold too late":
                return s
            s = s._replace(held=s.held or ())
            if self._bug == "mark overtakes":
                return s.with_stream(s.path, 0, (MARK, *s.streams(s.path)[0]))
            return s.flowing(s.path, 0, MARK)
        path: Side = "new" if step == "Release to new" else "old"
        if s.applied not in {"both", path}:
            return s
        held = s.held or ()
        return s._replace(path=path, held=None).flowing(path, 0, *held)

    def _at_old(
        self, s: State, which: int, step: str, *, is_late: bool
    ) -> Iterator[Taken]:
        old = s.olds[which]
        if old.phase in {"dead", "gone"}:
            yield s, False
        elif step == "Rest":
            # `Runner.rest`: waits until no chain is inside, marks all streams behind it
            if not old.stays and self._bug != "rest too late":
                yield s, False
            elif (
                (old.inside < 0 and not old.outside)
                or old.phase == "inactive"
                or self._bug == "no drain"
            ):
                phase = "inactive" if old.phase == "inactive" else "rest"
                resting = s.with_one("old", which, old._replace(phase=phase))
                yield resting.flowing("old", which + 1, MARK), True
        elif step == "Flush, Give":
            for after, is_done in self._flush(
                s, is_marked=old.is_marked, is_late=is_late
            ):
                given = old._replace(gives=old.gives or is_done)
                yield after.with_one("old", which, given), is_done
        elif step == "Retire":
            yield s.with_one("old", which, old._replace(is_retired=True)), True
        else:
            yield working(s, "old", which), True

    def _at_new(
        self, s: State, which: int, step: str, *, is_late: bool
    ) -> Iterator[Taken]:
        old, new = s.olds[which], s.news[which]
        if new.phase in {"dead", "gone"}:
            yield s, False
        elif step == "Take":
            # `StateSender._all` waits for `Give`, and refuses unless at rest
            is_at_rest = old.phase == "rest" or (old.phase == "inactive" and old.stays)
            if old.gives and is_at_rest:
                taken = new._replace(inbox=old.inbox, log=old.log)
                yield s.with_one("new", which, taken), True
                yield s, False  # its `restore` raised
            elif is_late or s.kills or old.gives:
                yield s, False
        elif step == "Activate":
            yield s.with_one("new", which, self._activated(new, which)), True
            yield s, False  # its `activate` raised
        else:
            yield working(s, "new", which), True

    def _activated(self, new: Incarnation, which: int) -> Incarnation:
        """`Ends.keep_back`: what `activate` publishes goes out with `Open`."""
        said: tuple[float, ...] = ()
        if self._bounds.speaks and which == self._bounds.movers - 1:
            said = (max(new.log, default=0) + 0.5,)
        phase = "work" if self._bug == "work before it is kept" else "ready"
        return new._replace(phase=phase, kept_back=said)

    # poise.runtime.connectors, and what carries them

    def _streams(self, s: State) -> Iterator[tuple[str, State]]:
        for side in SIDES:
            for to, stream in enumerate(s.streams(side)):
                if stream:
                    rest = s.with_stream(side, to, stream[1:])
                    if to == self._bounds.movers:
                        yield _at_sink(rest, stream[0])
                    else:
                        yield _arrived(rest, side, to, stream[0])
        if self._bug == "speak at once":
            for which, new in enumerate(s.news):
                if new.kept_back:
                    said = s.with_one("new", which, new._replace(kept_back=()))
                    yield "speaks", said.flowing("new", which + 1, *new.kept_back)

    def _work(self, s: State) -> Iterator[tuple[str, State]]:
        if not s.is_source_dead and s.sent < self._bounds.messages:
            number = s.sent + 1
            published = s._replace(sent=number)
            if s.held is not None:
                yield "publish (held)", published._replace(held=(*s.held, number))
            else:
                yield "publish", published.flowing(s.path, 0, number)
        for side in SIDES:
            for which, one in enumerate(s.all_of(side)):
                if one.phase == "work" and one.inside < 0 and one.inbox:
                    item, *inbox = one.inbox
                    after = one._replace(inbox=tuple(inbox), log=(*one.log, item))
                    done = s.with_one(side, which, after)
                    yield f"{side} {which} works", done.flowing(side, which + 1, item)

    # poise.runtime.container.container.Container._apply, told by `Exchange._remove`

    def _deployments(self, s: State) -> Iterator[tuple[str, State]]:
        if s.spec == "both":
            return
        kept: Side = "new" if s.spec == "new" else "old"
        gone: Side = "old" if kept == "new" else "new"
        if s.applied != s.spec and not s.is_source_dead:
            # `Sender.remove`: one path is left, and what was held goes there
            path = kept if self._bug != "keep the path" else s.path
            told = s._replace(applied=s.spec, path=path)
            if self._bug != "hold for ever" and s.held is not None:
                told = told._replace(held=None).flowing(path, 0, *s.held)
            yield "source is told", told
        for which, one in enumerate(s.all_of(kept)):
            name = f"{kept} {which}"
            if name not in s.told and one.phase != "dead":
                told = s._replace(told=s.told | {name})
                yield f"{name} is told", working(told, kept, which)
        for which, one in enumerate(s.all_of(gone)):
            is_left = one.phase not in {"dead", "gone"} and one.inside < 0
            if is_left and not one.outside and self._bug != "remove nothing":
                removed = s.with_one(gone, which, one._replace(phase="gone"))
                yield f"{gone} {which} is removed", removed


def _late(s: State) -> State:
    """Let what was not answered be taken later; a `Flush` at the sink only waits."""
    pending = {o for o in s.orders if o.outcome == "sent" and o.container != "sink"}
    return s._replace(late=s.late | pending)


def working(s: State, side: Side, which: int) -> State:
    """`Runner.aim("active")`."""
    one = s.one(side, which)
    if one.phase in {"dead", "gone"}:
        return s.with_one(side, which, one._replace(stays=False))
    said = one.kept_back
    one = one._replace(phase="work", stays=False, kept_back=())
    return s.with_one(side, which, one).flowing(side, which + 1, *said)


def _arrived(s: State, side: Side, which: int, item: float) -> tuple[str, State]:
    one = s.one(side, which)
    name = f"{side} {which}"
    if one.phase == "dead":
        return f"lost before {name}", s._replace(excused=s.excused | {item})
    if one.phase == "gone":
        return f"lost before {name}", s
    if item == MARK:
        one = one._replace(is_marked=True)
    else:
        one = one._replace(inbox=(*one.inbox, item))
    return f"arrives at {name}", s.with_one(side, which, one)


def _at_sink(s: State, item: float) -> tuple[str, State]:
    if s.is_sink_dead:
        return "lost before sink", s._replace(excused=s.excused | {item})
    if item == MARK:
        return "mark at sink", s._replace(is_sink_marked=True)
    return "arrives at sink", s._replace(got=(*s.got, item))


def _after(order: Order, *, is_done: bool) -> Order:
    if not is_done:
        return order._replace(outcome="failed")
    left = order.steps[1:]
    return order._replace(steps=left, outcome="sent" if left else "done")


def _said(order: Order) -> str:
    return f"{order.steps[0]} at {order.container}"
