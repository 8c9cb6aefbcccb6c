"""What a killed container leads to, and how it begins anew."""

from __future__ import annotations

from collections.abc import Iterator

from tests.model_of_moves.calls import break_off, break_off_source
from tests.model_of_moves.world import Bounds, Incarnation, Side, State


class Faults:
    """Kills, as many as the bounds allow, and new starts."""

    def __init__(self, bounds: Bounds, bug: str) -> None:
        self._bounds = bounds
        self._bug = bug

    def successors(self, s: State) -> Iterator[tuple[str, State]]:
        """Yield what may break, and what begins anew."""
        if s.kills < self._bounds.kills:
            yield from self._kills(s._replace(kills=s.kills + 1))
        yield from self._starts(s)

    def _kills(self, s: State) -> Iterator[tuple[str, State]]:
        if "S" in self._bounds.killed and not s.is_source_dead:
            dead = break_off_source(s, self._bounds)._replace(
                is_source_dead=True, excused=s.excused | set(s.held or ())
            )
            yield "kill source", _failed(dead, "source")
        sides: tuple[Side, Side] = ("old", "new")
        for side in sides:
            for which, one in enumerate(s.all_of(side)):
                is_there = one.phase not in {"dead", "gone"}
                if side[0] in self._bounds.killed and is_there:
                    yield f"kill {side} {which}", self._killed(s, side, which)
            if side[0].upper() in self._bounds.killed:
                dead = s
                for which, one in enumerate(s.all_of(side)):
                    if one.phase not in {"dead", "gone"}:
                        dead = self._killed(dead, side, which)
                yield f"kill the agent of {side}", dead
        if "D" in self._bounds.killed and not s.is_sink_dead:
            dead = s._replace(is_sink_dead=True, is_sink_marked=False)
            yield "kill sink", _failed(dead, "sink")

    def _killed(self, s: State, side: Side, which: int) -> State:
        one, streams = s.one(side, which), s.streams(side)
        inside = {
            *one.inbox,
            *one.log,
            *one.kept_back,
            *streams[which],
            *streams[which + 1],
        }
        dead = s._replace(excused=s.excused | inside)
        dead = break_off(dead, self._bounds, self._bug, side, which)
        dead = dead.with_one(side, which, Incarnation("dead", party="start"))
        return _failed(dead.with_stream(side, which + 1, ()), f"{side} {which}")

    def _starts(self, s: State) -> Iterator[tuple[str, State]]:
        if s.is_source_dead:
            # `Wiring._hold_amid_a_move`
            path: Side = "new" if s.spec == "new" else "old"
            held = () if s.spec == "both" and self._bug != "send at birth" else None
            born = s._replace(is_source_dead=False, path=path, held=held)
            yield "source starts", born._replace(applied=s.spec)
        if s.is_sink_dead:
            yield "sink starts", s._replace(is_sink_dead=False)
        sides: tuple[Side, Side] = ("old", "new")
        for side in sides:
            for which, one in enumerate(s.all_of(side)):
                if one.phase == "dead":
                    yield f"{side} {which} starts", self._born(s, side, which)

    def _born(self, s: State, side: Side, which: int) -> State:
        phase = {"both": "inactive", side: "work"}.get(s.spec, "gone")
        if self._bug == "work at birth" and (side, s.spec) == ("old", "both"):
            phase = "work"
        stays = side == "old" and s.spec == "both"
        told = s.told if s.spec == "both" else s.told | {f"{side} {which}"}
        born = Incarnation(phase, stays=stays, party="start")
        return s._replace(told=told).with_one(side, which, born)


def _failed(s: State, container: str) -> State:
    """Let the agent answer the orders of a container that ended."""
    orders = tuple(
        order._replace(outcome="failed")
        if (order.container, order.outcome) == (container, "sent")
        else order
        for order in s.orders
    )
    late = frozenset(order for order in s.late if order.container != container)
    return s._replace(orders=orders, late=late)
