"""Calls to components that move, and between two that move at once.

A caller `c` calls the first of them, `r` is called back by what its callee calls. The
callee of `d` calls the second on its way *down*; `u` is a timer of the second, which
calls *up* to the first. With both, calls go in a circle, and the first is re-entrant:
others come in while it waits in a call of its own.
"""

from __future__ import annotations

from collections.abc import Iterator

from tests.model_of_moves.world import Bounds, Side, State

ROUTES = {"c": (0,), "r": (0,), "d": (0, 1), "u": (1, 0)}
"""The components that a caller's chain enters, one in a call of the other."""
SIDES: tuple[Side, Side] = ("old", "new")


class Calls:
    """Follows each call: `Route.function`, `Exclusion`, `Sender.again`."""

    def __init__(self, bounds: Bounds, bug: str) -> None:
        self._bounds = bounds
        self._bug = bug

    def successors(self, s: State) -> Iterator[tuple[str, State]]:
        """Yield what may happen to the calls."""
        for who, letter in enumerate(self._bounds.callers):
            for name, after in self._follow(s, who, letter):
                yield f"caller {who} {name}", after

    def _follow(self, s: State, who: int, letter: str) -> Iterator[tuple[str, State]]:
        where, path = s.calls[who]
        first, second = (*ROUTES[letter], -1)[:2]
        if where in {"answered", "error"} or (s.is_source_dead and letter != "u"):
            return
        if where in {"begins", "moved"}:
            yield from self._begin(s, who, letter)
            return
        side: Side = "old" if path == "old" else "new"
        if where == "waits":
            yield from self._enter(s, who, side, first)
        elif where == "asks":
            yield from self._enter_further(s, who, side, second)
        elif where == "inside" and letter == "r":
            # the callee calls the sink, which calls back in the same chain
            yield "goes out", at(s, who, "out", path)
        elif where == "inside" and second >= 0:
            yield "asks further", at(self._step_out(s, who, side, first), who, "asks")
        elif where == "further":
            left = s.with_one(side, second, s.one(side, second)._replace(inside=-1))
            yield "comes back", at(left, who, "returns")
        elif where == "returns":
            yield from self._step_in(s, who, side, first)
        elif where == "adrift":
            yield from self._drift(s, who, side, second)
        else:
            # a chain that comes back is let in though others wait, also for the rest
            left = s.with_one(side, first, s.one(side, first)._replace(inside=-1))
            yield "is answered", at(left, who, "answered")

    def _begin(self, s: State, who: int, letter: str) -> Iterator[tuple[str, State]]:
        where, path = s.calls[who]
        if letter != "u":
            if where == "begins" or path != s.path:
                yield f"calls {s.path}", at(s, who, "waits", s.path)
            return
        for side in SIDES:  # `Runner._run_timer`
            if _is_free(s, side, 1):
                yield f"is due on {side}", self._inside(s, who, side, 1, "inside")

    def _enter(
        self, s: State, who: int, side: Side, which: int
    ) -> Iterator[tuple[str, State]]:
        """`Exclusion.enter`: redirected, or free, or paused."""
        one = s.one(side, which)
        if one.phase == "dead":
            yield "gets Unavailable", at(s, who, "error")
        elif one.is_redirected or one.phase == "gone":
            yield "is told that it moved", at(s, who, "moved")
        elif _is_free(s, side, which):
            yield "is inside", self._inside(s, who, side, which, "inside")

    def _enter_further(
        self, s: State, who: int, side: Side, which: int
    ) -> Iterator[tuple[str, State]]:
        """Enter what the callee calls; it gets an error when that has ended or moved.

        Its own outlet leads to one incarnation alone: `Sender.again` waits in vain.
        """
        one = s.one(side, which)
        if one.phase in {"dead", "gone"} or one.is_redirected or s.kills:
            # with kills also for what was started anew, and rests: the call's limit
            yield "gets no further", at(s, who, "returns")
        if _is_free(s, side, which):
            yield "is further", self._inside(s, who, side, which, "further")

    def _drift(
        self, s: State, who: int, side: Side, which: int
    ) -> Iterator[tuple[str, State]]:
        """Go on with a call whose caller was killed: it runs, or not, and ends."""
        one = s.one(side, which)
        if one.inside == who:
            left = s.with_one(side, which, one._replace(inside=-1))
            yield "ends, for nobody", at(left, who, "error")
            return
        yield "is given up", at(s, who, "error")
        if _is_free(s, side, which):
            yield "goes on adrift", self._inside(s, who, side, which, "adrift")

    def _inside(self, s: State, who: int, side: Side, which: int, where: str) -> State:
        runs = {**dict(s.runs)}
        runs[who, which] = runs.get((who, which), 0) + 1
        entered = s.with_one(side, which, s.one(side, which)._replace(inside=who))
        entered = entered._replace(runs=tuple(sorted(runs.items())))
        return at(entered, who, where, side)

    def _is_reentrant(self, which: int) -> bool:
        return which == 0 and self._bounds.is_circle and self._bug != "not re-entrant"

    def _step_out(self, s: State, who: int, side: Side, which: int) -> State:
        if not self._is_reentrant(which):
            return s
        one = s.one(side, which)
        outside = () if self._bug == "pause without them" else (*one.outside, who)
        return s.with_one(side, which, one._replace(inside=-1, outside=outside))

    def _step_in(
        self, s: State, who: int, side: Side, which: int
    ) -> Iterator[tuple[str, State]]:
        one = s.one(side, which)
        if one.inside == who:
            yield "goes on", at(s, who, "last")
        elif one.inside < 0:
            outside = tuple(each for each in one.outside if each != who)
            back = one._replace(inside=who, outside=outside)
            yield "steps in", at(s.with_one(side, which, back), who, "last")


def _is_free(s: State, side: Side, which: int) -> bool:
    one = s.one(side, which)
    return one.phase == "work" and one.inside < 0


def at(s: State, who: int, where: str, path: str = "") -> State:
    """Return the state with a call at another place; its path stays without one."""
    calls = list(s.calls)
    calls[who] = (where, path or calls[who][1])
    return s._replace(calls=tuple(calls))


def break_off(s: State, bounds: Bounds, bug: str, side: Side, which: int) -> State:
    """End what the killing of one incarnation ends: calls to it, and from it."""
    for who, letter in enumerate(bounds.callers):
        where, path = s.calls[who]
        if path != side or where in {"answered", "error", "begins"}:
            continue
        first, second = (*ROUTES[letter], -1)[:2]
        if which == first:
            # what it has called knows nothing of that
            broken = "begins" if bug == "repeat what broke off" else "error"
            s = at(s, who, "adrift" if where in {"asks", "further"} else broken)
        elif which == second and where in {"asks", "further"}:
            s = at(s, who, "returns")
        elif which == second and where == "adrift":
            s = at(s, who, "error")
    return s


def break_off_source(s: State, bounds: Bounds) -> State:
    """End the calls whose caller was killed; their chains end at once."""
    from_there = {who for who, letter in enumerate(bounds.callers) if letter != "u"}
    for who in from_there:
        if s.calls[who][0] != "answered":
            s = at(s, who, "error")
    for side in SIDES:
        for which, one in enumerate(s.all_of(side)):
            free = one._replace(
                inside=-1 if one.inside in from_there else one.inside,
                outside=tuple(each for each in one.outside if each not in from_there),
            )
            s = s.with_one(side, which, free)
    return s
