"""The protocol of a move as a model: every order in which things can happen.

One component is moved from container `old` to container `new`. A source container
publishes to it and has callers; what it gets it publishes to a sink. The names of the
steps are those of `poise.manage.move.Move`, `poise.runtime.steps.Steps` and what they
use.

The manager may give any round of orders up at any time: an order that it gave up is
lost, or is still taken at any moment after that. Any container may be killed at any
moment, and is started anew with what its agent was told last.
"""

from __future__ import annotations

from collections.abc import Iterator

from tests.model_of_moves.world import MARK, Bounds, Incarnation, State, changed

ROUNDS = {
    "shut": ("Hold", "Rest"),
    "flush": ("Flush at old", "Flush at sink"),
    "take": ("Take", "Activate"),
    "keep": ("Open new", "Release to new", "Retire"),
    "back": ("Open old", "Release to old"),
}
AT = {
    "Hold": "source",
    "Release to new": "source",
    "Release to old": "source",
    "Rest": "old",
    "Flush at old": "old",
    "Retire": "old",
    "Open old": "old",
    "Flush at sink": "sink",
    "Take": "new",
    "Activate": "new",
    "Open new": "new",
}


def initial(bounds: Bounds) -> State:
    """Return the state after `Move._prepare`."""
    return State(
        old=Incarnation("work", stays=True),
        new=Incarnation("inactive"),
        orders=tuple((name, "sent") for name in ROUNDS["shut"]),
        calls=(("begins", ""),) * len(bounds.callers),
        runs=(0,) * len(bounds.callers),
    )


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

    def successors(self, s: State) -> Iterator[tuple[str, State]]:
        """Yield all that may happen next."""
        yield from self._manager(s)
        for name, outcome in s.orders:
            # one container takes the steps of one order one after the other
            is_next = name != "Activate" or dict(s.orders)["Take"] == "done"
            if outcome == "sent" and is_next:
                for taken, result in self._take(s, name):
                    yield name, _noted(taken, name, result)
        for name in s.stale:
            for taken, _ in self._take(s, name):
                yield f"{name} (late)", taken._replace(stale=s.stale - {name})
        yield from self._streams(s)
        yield from self._work(s)
        for who in range(len(s.calls)):
            yield from self._call(s, who)
        yield from self._deployments(s)
        if s.kills < self._bounds.kills:
            yield from self._kills(s)
        yield from self._starts(s)

    # poise.manage.move.Move

    def _manager(self, s: State) -> Iterator[tuple[str, State]]:
        if s.round in {"remove", "end"}:
            if s.round == "remove" and _is_gone(s, s.spec):
                yield "removed", s._replace(round="end")
            return
        outcomes = {outcome for _, outcome in s.orders}
        if outcomes == {"done"}:
            yield f"{s.round} is done", self._next(s, failed=False)
        elif "sent" not in outcomes:
            yield f"{s.round} failed", self._next(s, failed=True)
        elif s.given_up < self._bounds.gives_up:
            pending = {name for name, outcome in s.orders if outcome == "sent"}
            s = s._replace(given_up=s.given_up + 1)
            yield f"{s.round} is given up", self._next(s, failed=True)
            # a late `Flush` only waits
            late = s.stale | {name for name in pending if "Flush" not in name}
            yield f"{s.round} is late", self._next(s._replace(stale=late), failed=True)

    def _next(self, s: State, *, failed: bool) -> State:
        if s.round in {"keep", "back"}:
            spec = "new" if s.round == "keep" else "old"
            return s._replace(round="remove", orders=(), spec=spec)
        following = {"shut": "flush", "flush": "take", "take": "keep"}[s.round]
        if self._bug == "no flush" and s.round == "shut":
            following = "take"
        if failed:
            following = "back"
        if self._bug == "ignore failures" and failed:
            following = "keep"
        orders = tuple((name, "sent") for name in ROUNDS[following])
        return s._replace(round=following, orders=orders)

    # poise.runtime.steps.Steps

    def _take(self, s: State, name: str) -> Iterator[tuple[State, str]]:
        """Yield the states after an order and what is answered; nothing: it waits."""
        where = AT[name]
        if where == "source":
            yield changed(s, **self._at_source(s, name)), "done"
        elif where == "sink":
            yield from self._flush(s, is_marked=s.is_sink_marked)
        elif name in {"Rest", "Flush at old", "Retire", "Open old"}:
            yield from self._at_old(s, name)
        else:
            yield from self._at_new(s, name)

    def _flush(self, s: State, *, is_marked: bool) -> Iterator[tuple[State, str]]:
        """`Ends.wait_marks`; its limit matters when a killed one had the mark."""
        if is_marked:
            yield s, "done"
        elif s.kills:
            yield s, "failed"

    def _at_source(self, s: State, name: str) -> dict[str, object]:
        """`Outlet.hold`, `Outlet.mark`, `Outlet.release`."""
        if name == "Hold":
            if s.applied != "both" and self._bug != "hold too late":
                return {}
            stream = _stream(s, s.path)
            stream = (
                (MARK, *stream) if self._bug == "mark overtakes" else (*stream, MARK)
            )
            return {"held": s.held or (), f"to_{s.path}": stream}
        path = name.removeprefix("Release to ")
        if s.applied not in {"both", path}:
            return {}
        return {
            "path": path,
            "held": None,
            f"to_{path}": _stream(s, path) + (s.held or ()),
        }

    def _at_old(self, s: State, name: str) -> Iterator[tuple[State, str]]:
        old = s.old
        if old.phase in {"dead", "gone"}:
            yield s, "failed"
        elif name == "Rest":
            # `Runner.rest`: waits until no chain is inside, marks all streams behind it
            if not old.stays and self._bug != "rest too late":
                yield s, "failed"
            elif old.phase == "inactive":
                yield s._replace(from_old=(*s.from_old, MARK)), "done"
            elif old.inside < 0 or self._bug == "no drain":
                marked = s._replace(from_old=(*s.from_old, MARK))
                yield marked._replace(old=old._replace(phase="rest")), "done"
        elif name == "Flush at old":
            yield from self._flush(s, is_marked=old.is_marked)
        elif name == "Retire":
            yield s._replace(old=old._replace(is_retired=True)), "done"
        else:
            yield s._replace(old=_working(old)), "done"

    def _at_new(self, s: State, name: str) -> Iterator[tuple[State, str]]:
        old, new = s.old, s.new
        if new.phase in {"dead", "gone"}:
            yield s, "failed"
        elif name == "Take":
            # `Giver._all` refuses unless at rest; its container answers, or has ended
            if old.phase == "rest" or (old.phase == "inactive" and old.stays):
                taken = new._replace(inbox=old.inbox, log=old.log)
                yield s._replace(new=taken), "done"
            else:
                yield s, "failed"
            yield s, "failed"  # its `restore` raised
        elif name == "Activate":
            phase = "work" if self._bug == "work before it is kept" else "ready"
            yield s._replace(new=new._replace(phase=phase)), "done"
            yield s, "failed"  # its `activate` raised
        else:
            yield s._replace(new=_working(new)), "done"

    # poise.runtime.connectors, and what carries them

    def _streams(self, s: State) -> Iterator[tuple[str, State]]:
        for name in ("old", "new"):
            stream, to = _stream(s, name), getattr(s, name)
            if stream:
                item, rest = stream[0], {f"to_{name}": stream[1:]}
                if to.phase == "dead":
                    excused = s.excused | {item}
                    yield f"lost before {name}", changed(s, **rest, excused=excused)
                elif to.phase == "gone":
                    yield f"lost before {name}", changed(s, **rest)
                else:
                    if item == MARK:
                        to = to._replace(is_marked=True)
                    else:
                        to = to._replace(inbox=(*to.inbox, item))
                    yield f"arrives at {name}", changed(s, **rest, **{name: to})
            out = s.from_old if name == "old" else s.from_new
            if out:
                item, rest = out[0], {f"from_{name}": out[1:]}
                if s.is_sink_dead:
                    excused = s.excused | {item}
                    yield "lost before sink", changed(s, **rest, excused=excused)
                elif item == MARK:
                    yield "mark at sink", changed(s, **rest, is_sink_marked=True)
                else:
                    yield "arrives at sink", changed(s, **rest, got=(*s.got, item))

    def _work(self, s: State) -> Iterator[tuple[str, State]]:
        if not s.is_source_dead and s.sent < self._bounds.messages:
            number = s.sent + 1
            published = s._replace(sent=number)
            if s.held is not None:
                yield "publish (held)", published._replace(held=(*s.held, number))
            else:
                stream = {f"to_{s.path}": (*_stream(s, s.path), number)}
                yield "publish", changed(published, **stream)
        for name in ("old", "new"):
            one = getattr(s, name)
            if one.phase == "work" and one.inside < 0 and one.inbox:
                item, *inbox = one.inbox
                one = one._replace(inbox=tuple(inbox), log=(*one.log, item))
                out = s.from_old if name == "old" else s.from_new
                yield (
                    f"{name} works",
                    changed(s, **{name: one, f"from_{name}": (*out, item)}),
                )

    def _call(self, s: State, who: int) -> Iterator[tuple[str, State]]:
        """Follow a call: `Path.function`, `Turn`, `Outlet.again`."""
        where, path = s.calls[who]
        if s.is_source_dead or where in {"answered", "error"}:
            return
        if where in {"begins", "moved"}:
            if where == "begins" or path != s.path:
                yield f"caller {who} calls {s.path}", _at(s, who, "waits", s.path)
            return
        one: Incarnation = getattr(s, path)
        if one.phase == "dead":
            yield f"caller {who}: Unavailable", _at(s, who, "error", path)
        elif where == "waits":
            # `Turn`: retired, or free, or shut
            if one.is_retired or one.phase == "gone":
                yield f"caller {who}: moved", _at(s, who, "moved", path)
            elif one.phase == "work" and one.inside < 0:
                runs = tuple(n + (i == who) for i, n in enumerate(s.runs))
                inside = changed(s, **{path: one._replace(inside=who)}, runs=runs)
                yield f"caller {who} is inside", _at(inside, who, "inside", path)
        elif where == "inside" and self._bounds.callers[who] == "r":
            # the callee calls the sink, which calls back in the same chain
            yield f"caller {who} goes out", _at(s, who, "out", path)
        else:
            # a chain that comes back is let in though others wait, also for the rest
            left = changed(s, **{path: one._replace(inside=-1)})
            yield f"caller {who} is answered", _at(left, who, "answered", path)

    # poise.runtime.container.Container._apply, told by `Move._remove`

    def _deployments(self, s: State) -> Iterator[tuple[str, State]]:
        if s.spec == "both":
            return
        kept, gone = s.spec, "old" if s.spec == "new" else "new"
        if s.applied != s.spec and not s.is_source_dead:
            # `Outlet.remove`: one path is left, and what was held goes there
            path = kept if self._bug != "keep the path" else s.path
            stream, held = {}, s.held
            if self._bug != "hold for ever" and held is not None:
                stream, held = {f"to_{path}": (*_stream(s, path), *held)}, None
            s2 = changed(s, applied=s.spec, path=path, held=held, **stream)
            yield "source is told", s2
        one, other = getattr(s, kept), getattr(s, gone)
        if kept not in s.told and one.phase != "dead":
            told = s._replace(told=s.told | {kept})
            yield f"{kept} is told", changed(told, **{kept: _working(one)})
        is_left = other.phase not in {"dead", "gone"} and other.inside < 0
        if is_left and self._bug != "remove nothing":
            yield (
                f"{gone} is removed",
                changed(s, **{gone: other._replace(phase="gone")}),
            )

    # faults

    def _kills(self, s: State) -> Iterator[tuple[str, State]]:
        s = s._replace(kills=s.kills + 1)
        if "S" in self._bounds.killed and not s.is_source_dead:
            excused = s.excused | set(s.held or ())
            dead = _broken_off(s, {"old", "new", ""})
            dead = dead._replace(
                is_source_dead=True,
                excused=excused,
                old=s.old._replace(inside=-1),
                new=s.new._replace(inside=-1),
            )
            yield "kill source", _failed(dead, "source")
        for name in ("old", "new"):
            one: Incarnation = getattr(s, name)
            if name[0] in self._bounds.killed and one.phase not in {"dead", "gone"}:
                out = s.from_old if name == "old" else s.from_new
                inside = {*one.inbox, *one.log, *_stream(s, name), *out}
                dead = _broken_off(s, {name})._replace(excused=s.excused | inside)
                dead = changed(dead, **{name: Incarnation("dead"), f"from_{name}": ()})
                yield f"kill {name}", _failed(dead, name)
        if "D" in self._bounds.killed and not s.is_sink_dead:
            dead = s._replace(is_sink_dead=True, is_sink_marked=False)
            yield "kill sink", _failed(dead, "sink")

    def _starts(self, s: State) -> Iterator[tuple[str, State]]:
        if s.is_source_dead:
            # `Wiring._hold_amid_a_move`
            path = "old" if s.spec == "both" else s.spec
            held = () if s.spec == "both" and self._bug != "send at birth" else None
            born = s._replace(is_source_dead=False, path=path, held=held)
            yield "source starts", born._replace(applied=s.spec)
        if s.is_sink_dead:
            yield "sink starts", s._replace(is_sink_dead=False)
        for name in ("old", "new"):
            if getattr(s, name).phase == "dead":
                phase = {"both": "inactive", name: "work"}.get(s.spec, "gone")
                if self._bug == "work at birth" and name == "old":
                    phase = "work" if s.spec == "both" else phase
                born_one = Incarnation(phase, stays=name == "old" and s.spec == "both")
                told = s.told if s.spec == "both" else s.told | {name}
                yield f"{name} starts", changed(s, **{name: born_one}, told=told)


def _is_gone(s: State, spec: str) -> bool:
    other: Incarnation = s.old if spec == "new" else s.new
    return other.phase in {"gone", "dead"}


def _working(one: Incarnation) -> Incarnation:
    """`Runner.aim("active")`."""
    phase = one.phase if one.phase in {"dead", "gone"} else "work"
    return one._replace(phase=phase, stays=False)


def _noted(s: State, name: str, outcome: str) -> State:
    orders = dict(s.orders) | {name: outcome}
    if (name, outcome) == ("Take", "failed"):
        orders["Activate"] = "failed"
    return s._replace(orders=tuple(orders.items()))


def _failed(s: State, container: str) -> State:
    """Let the agent answer the orders of a container that ended."""
    orders = tuple(
        (name, "failed" if AT[name] == container and outcome == "sent" else outcome)
        for name, outcome in s.orders
    )
    stale = frozenset(name for name in s.stale if AT[name] != container)
    return s._replace(orders=orders, stale=stale)


def _broken_off(s: State, paths: set[str]) -> State:
    """End every call over one of these paths with an error."""
    calls = tuple(
        ("error" if path in paths and where != "answered" else where, path)
        for where, path in s.calls
    )
    return s._replace(calls=calls)


def _stream(s: State, name: str) -> tuple[int, ...]:
    return s.to_old if name == "old" else s.to_new


def _at(s: State, who: int, where: str, path: str) -> State:
    calls = list(s.calls)
    calls[who] = (where, path)
    return s._replace(calls=tuple(calls))
