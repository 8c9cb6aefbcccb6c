"""The protocol of a move as a model: every order in which things can happen.

One component is moved, or two neighbours at once, each from a container ``old`` to a
container ``new``. A source publishes to the first and has callers there; what a
component gets, it publishes to the next, and the last to a sink. Calls go from one to
the other, too. Names and phases of the steps, and which phase may follow which, are
those of `poise.wire.records.migration_records`.
``test_replay.py`` replays what real agents did.

The manager may give up a round at any time, and does so when a step fails: a step that
was not answered is lost, or is still taken at any later moment. Any container may be
killed at any moment, and is started again with what its agent was told last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from poise.wire.records.migration_records import STEPS, TRANSITIONS, Before, Phase
from tests.model_of_moves.calls import SIDES, Calls
from tests.model_of_moves.faults import Faults
from tests.model_of_moves.world import MARK, Bounds, Incarnation, Order, Side, State

Taken = tuple[State, bool]
"""The state after a step, and whether the step succeeded."""

PHASES: dict[str, Phase] = {name: phase for name, (_, phase) in STEPS.items()}
"""The steps of components, and the phases that they lead to."""


def initial(bounds: Bounds, bug: str = "") -> State:
    """Return the state before the first round of the preparation, or after it."""
    count = bounds.movers
    nothing = ((),) * (count + 1)
    party: Before = "start" if bounds.prepares else "prepare"
    orders = prepare(bounds) if bounds.prepares else transfer(bounds, bug)[0]
    return State(
        round="prepare" if bounds.prepares else "transfer 0",
        olds=(Incarnation("work", stays=True, party=party),) * count,
        news=(Incarnation("inactive", party=party),) * count,
        to_olds=nothing,
        to_news=nothing,
        orders=orders,
        calls=(("begins", ""),) * len(bounds.callers),
    )


def prepare(bounds: Bounds) -> tuple[Order, ...]:
    """Return `MigrationRounds.prepare`."""
    steps: dict[str, tuple[str, ...]] = {}
    for k in range(bounds.movers):
        steps[f"old {k}"] = "offer state", "await idle"
        steps[f"new {k}"] = "pre-copy", "request state"
    return _orders(steps)


def transfer(bounds: Bounds, bug: str) -> list[tuple[Order, ...]]:
    """Return `MigrationRounds.transfer`: callers pause before their callees."""
    movers = range(bounds.movers)
    levels = [list(movers)] if bug == "pause at once" else bounds.levels()
    rounds: list[tuple[Order, ...]] = []
    for level in levels:
        pausing = {k: ("pause",) if k in level else () for k in movers}
        last = len(rounds) == len(levels) - 1
        steps = {
            "source": () if rounds else ("buffer",),
            "sink": ("drain channels",) * last,
        }
        steps |= {
            f"old {k}": pausing[k] + ("drain channels", "send state") * last
            for k in movers
        }
        steps |= {f"new {k}": ("restore state", "activate") * last for k in movers}
        rounds.append(_orders(steps))
    return rounds


def resuming(side: Side, bounds: Bounds) -> tuple[Order, ...]:
    """Return `MigrationRounds.resume`, or `MigrationRounds.roll_back`."""
    movers = range(bounds.movers)
    step = "resume" if side == "new" else "roll back"
    steps: dict[str, tuple[str, ...]] = {f"{side} {k}": (step,) for k in movers}
    steps["source"] = (f"release to {side}",)
    if side == "new":
        steps |= {f"old {k}": ("redirect",) for k in movers}
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
        self._rounds = transfer(bounds, bug)
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

    # poise.manage.migration.coordinator.Migration

    def _manager(self, s: State) -> Iterator[tuple[str, State]]:
        if s.round in {"remove", "end"}:
            gone = s.all_of("old" if s.spec == "new" else "new")
            if s.round == "remove" and all(o.phase in {"gone", "dead"} for o in gone):
                yield "removed", s._replace(round="end")
            return
        outcomes = {order.outcome for order in s.orders}
        pending = "sent" in outcomes
        is_transfer = s.round.startswith(("prepare", "transfer"))
        if outcomes == {"done"}:
            yield f"{s.round} is done", self._next(s, failed=False)
        elif "failed" in outcomes and (is_transfer or not pending):
            yield f"{s.round} failed", self._next(_late(s), failed=True)
        elif pending and s.given_up < self._bounds.gives_up:
            s = s._replace(given_up=s.given_up + 1)
            yield f"{s.round} is given up", self._next(s, failed=True)
            if self._bounds.late:
                yield f"{s.round} is late", self._next(_late(s), failed=True)

    def _next(self, s: State, *, failed: bool) -> State:
        if s.round in {"resume", "roll back"}:
            spec = "new" if s.round == "resume" else "old"
            return s._replace(round="remove", orders=(), spec=spec)
        phase, _, number = s.round.partition(" ")
        if phase == "prepare":
            if failed:
                return s._replace(round="remove", orders=(), spec="old")
            return s._replace(round="transfer 0", orders=self._rounds[0])
        if failed and self._bug != "ignore failures":
            return s._replace(round="roll back", orders=resuming("old", self._bounds))
        following = int(number) + 1
        if following < len(self._rounds) and not failed:
            orders = self._rounds[following]
            return s._replace(round=f"transfer {following}", orders=orders)
        return s._replace(round="resume", orders=resuming("new", self._bounds))

    # poise.runtime.migration.executor.MigrationExecutor

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
            for after, is_done in self._at_old(s, int(which), step, is_late=is_late):
                yield _entered(s, "old", int(which), step, after, is_done=is_done)
        else:
            for after, is_done in self._at_new(s, int(which), step, is_late=is_late):
                yield _entered(s, "new", int(which), step, after, is_done=is_done)

    def _flush(self, s: State, *, is_marked: bool, is_late: bool) -> Iterator[Taken]:
        """`wait_markers`; limited: a killed one may have had the marker."""
        if is_marked or self._bug == "no flush":
            yield s, True
        elif s.kills or is_late:
            yield s, False

    def _at_source(self, s: State, step: str) -> State:
        """`Sender.buffer_for_move`, `Sender.send_marker`, `Sender.switch`."""
        if step == "buffer":
            if s.applied != "both" and self._bug != "buffer too late":
                return s
            s = s._replace(held=s.held or ())
            if self._bug == "marker overtakes":
                return s.with_stream(s.path, 0, (MARK, *s.streams(s.path)[0]))
            return s.flowing(s.path, 0, MARK)
        path: Side = "new" if step == "release to new" else "old"
        if s.applied not in {"both", path}:
            return s
        held = s.held or ()
        return s._replace(path=path, held=None).flowing(path, 0, *held)

    def _at_old(
        self, s: State, which: int, step: str, *, is_late: bool
    ) -> Iterator[Taken]:
        old = s.olds[which]
        if step == "drain channels":
            yield from self._flush(s, is_marked=old.is_marked, is_late=is_late)
        elif step == "pause":
            # `Runner.rest`: waits until no chain is inside, then sends markers
            if not old.stays and self._bug != "pause too late":
                yield s, False
            elif (
                (old.inside < 0 and not old.outside)
                or old.phase == "inactive"
                or self._bug == "no drain"
            ):
                phase = "inactive" if old.phase == "inactive" else "rest"
                resting = s.with_one("old", which, old._replace(phase=phase))
                yield resting.flowing("old", which + 1, MARK), True
        elif PHASES[step] == "prepare":
            # `StateSender.wait_requested`
            if step == "offer state" or not _is_to_request(s, which):
                yield s, True
            elif s.kills or is_late:
                yield s, False
        elif step == "send state":
            yield s.with_one("old", which, old._replace(gives=True)), True
        elif step == "redirect":
            yield s.with_one("old", which, old._replace(is_redirected=True)), True
        else:
            yield working(s, "old", which), True

    def _at_new(
        self, s: State, which: int, step: str, *, is_late: bool
    ) -> Iterator[Taken]:
        old, new = s.olds[which], s.news[which]
        if PHASES[step] == "prepare":
            if step == "request state" or old.party != "start":  # it offers its state
                yield s, True
            if s.kills or is_late:
                yield s, False  # the source is gone
        elif step == "restore state":
            # `StateSender._all` waits for `send`, and refuses unless paused
            is_at_rest = old.phase == "rest" or (old.phase == "inactive" and old.stays)
            if old.gives and is_at_rest:
                taken = new._replace(inbox=old.inbox, log=old.log)
                yield s.with_one("new", which, taken), True
                yield s, False  # its `restore` raised
            elif is_late or s.kills or old.gives:
                yield s, False
        elif step == "activate":
            yield s.with_one("new", which, self._activated(new, which)), True
            yield s, False  # its `activate` raised
        else:
            yield working(s, "new", which), True

    def _activated(self, new: Incarnation, which: int) -> Incarnation:
        """`buffer_until_active`: `resume` sends what `activate` published."""
        said: tuple[float, ...] = ()
        if self._bounds.speaks and which == self._bounds.movers - 1:
            said = (max(new.log, default=0) + 0.5,)
        phase = "work" if self._bug == "work before the commit" else "ready"
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

    # `Container._apply` of what `coordinator.Migration` deploys

    def _deployments(self, s: State) -> Iterator[tuple[str, State]]:
        if s.spec == "both":
            return
        kept: Side = "new" if s.spec == "new" else "old"
        gone: Side = "old" if kept == "new" else "new"
        if s.applied != s.spec and not s.is_source_dead:
            # `Sender.remove`: one path is left, and what was held goes there
            path = kept if self._bug != "keep the path" else s.path
            told = s._replace(applied=s.spec, path=path)
            if self._bug != "buffer for ever" and s.held is not None:
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


def _entered(
    s: State, side: Side, which: int, step: str, after: State, *, is_done: bool
) -> Taken:
    """`MigrationPhases.check` before a step, and `enter` after it."""
    before, phase = s.one(side, which), PHASES[step]
    allowed = TRANSITIONS["source" if side == "old" else "target"].get(before.party, ())
    may_enter = step == "drain channels" or phase in {before.party, *allowed}
    if before.phase in {"dead", "gone"} or not may_enter:
        return s, False
    if not is_done or step == "drain channels":
        return after, is_done
    party = after.one(side, which)._replace(party=phase)
    return after.with_one(side, which, party), True


def _is_to_request(s: State, which: int) -> bool:
    """Return whether a target has still to request the state."""
    return any(
        order.container == f"new {which}" and "request state" in order.steps
        for order in (*s.orders, *s.late)
    )


def _late(s: State) -> State:
    """Let what was not answered be taken later; a step at the sink only waits."""
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
