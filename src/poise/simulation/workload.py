"""What a robot's components do in a simulation, from its profile, file and code.

A profile says how much CPU a component takes, how often its timers are due and for how
long they run, and what goes over each connector; not which handler sends what. Here

- handlers, timers and calls take what they were measured to take; what was not measured
  shares the rest;
- a connector is fed by a handler whose code names its port: of several by that whose
  rate is the nearest above its own, a fraction of whose runs send something: n out at
  n/s from a timer of n Hz go out at each run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from math import ceil, log, sqrt
from statistics import NormalDist

from msgspec import Struct, structs

from poise.estimate.profiles import WINDOW, ConnectorProfile, HandlerProfile, Profile
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.model.check.ros2_components import BRIDGE
from poise.model.robot import ComponentEntry, Connector, Robot
from poise.model.software import ComponentCode
from poise.runtime.component.ports import Timer
from poise.runtime.component.started_calls import ANSWER
from poise.simulation.component_models import (
    ComponentModel,
    Flaw,
    HandlerModel,
    Models,
    TimerModel,
    Traffic,
)

_SPREAD, _LEAST_SPREAD, _MOST_SPREAD = 0.3, 0.1, 1.0
_FEW = 0.1
"""A smaller share of windows than this, with one run more than the others, is none."""
_NORMAL = NormalDist()
_P95, _P99 = 1.645, 2.326
"""Percentiles of a standard normal distribution."""
_WAITED = 0.2
"""A run that waits for this share of its period waits for a device."""
LEFT_OUT = "what its runs wait for is left out here, and only their CPU counts"
"""Said of a timer that was late although nothing else ran."""
_LATE = 0.05
"""It missed at least this share of its deadlines."""
_HEADROOM = 1.05
"""A demand in the robot file is more than the mean by about this factor."""
_START, _USUAL_START = (0.8, 1.2), 0.2
"""A component is configured within about what was measured, or within this [s]."""
_COUNTED = 0.3
"""So much may a rate be off that was counted over a few seconds, while timers skipped
releases."""
_AS_OFTEN = 1.05
"""A handler feeds a connector whose rate is up to this factor above its own."""


_EVENLY = Timer("work", 0.01, None)
"""Takes the CPU of what has no handler that is known to run, as of a program."""


NO_PROFILE = (
    "no profile was measured: the ages are guessed from the CPU that components need; "
    "`poise profile` measures one, and the robot file names it, as in `profile: "
    "profile.yaml`"
)
"""Said where nothing was measured."""
NO_WAITS = (
    "the profile does not say how long some handlers wait for what is not CPU, such as "
    "a device: the ages are predicted as if they did not; `poise profile` measures it; "
    "handlers that run rarely need a longer --for"
)
"""Said of profiles that an older Poise wrote, or where a handler ran too rarely."""

Place = tuple[str, str, int]
"""Where something comes in: the port, the function that it comes from, and a number;
what comes from alternatives of that function comes to one place."""


class SimulatedWork(Struct, frozen=True, kw_only=True):
    """What all components of a robot do.

    `models`: component -> what it does; the others do the default.
    `traffic`: how large messages are, and what they cost.
    `flaws`: implementation -> what is wrong with it.
    `agent`: CPU of an agent [cores].
    `rate`: how often timers are due and something goes over connectors, together [Hz].
    `guesses`: what was assumed, because neither profile nor robot file nor code says
    it.
    """

    models: Models = {}
    traffic: Traffic = Traffic()
    flaws: Mapping[str, Flaw] = {}
    agent: float = 0.0
    rate: float = 0.0
    guesses: tuple[str, ...] = ()


def workload_of(
    robot: Robot,
    profile: Profile | None,
    cores: Mapping[str, tuple[float, ...]] = {},
    bag: Mapping[str, ConnectorProfile] = {},
) -> SimulatedWork:
    """Return what the components of a robot do.

    `profile`: its measurements; None: the robot file's demands and rates count.
    `cores`: component -> what it takes in each second, again and again [cores of the
    reference]; of the others the mean counts.
    `bag`: connector from a bridge -> how often and how large messages come over it.
    """
    guesses = [] if profile else [NO_PROFILE]
    profile = profile or Profile(
        robot=robot.name, poise="", computer="", speed=1.0, at="", seconds=0.0
    )
    layout = DeploymentLayout(robot, "")
    measured = {**bag, **profile.connectors}
    over = {
        str(connector): _traffic_of(connector, measured.get(str(connector)))
        for connector in robot.all_connectors()
    }
    models = {}
    for entry in robot.components():
        code, why = _code_of(robot, entry)
        if why:
            guesses.append(why)
        part = _ComponentWork(robot, layout, over, entry, code, profile, guesses.append)
        mean, taken = part.cpu(), cores.get(entry.name, ())
        factors = tuple(second / mean for second in taken) if mean else ()
        model = _at_rates(part.model(), _rates(robot, entry.name, bag))
        models[entry.name] = structs.replace(model, factors=factors)
    if unknown := list(_without_demand(robot, profile)):
        guesses.append(f"no CPU is known of {', '.join(unknown)}: it takes none here")
    if not all(_knows_waits(robot, profile)):
        guesses.append(NO_WAITS)
    traffic = Traffic(
        sizes={name: t.size for name, t in {**over, **bag}.items() if t.size},
        calling=frozenset(name for name, t in over.items() if t.calls),
        costs=profile.costs,
    )
    timers = [each.timer for model in models.values() for each in model.timers]
    rates = (*(1 / timer.period for timer in timers), *(t.rate for t in over.values()))
    return SimulatedWork(
        models=models,
        traffic=traffic,
        agent=profile.agent,
        rate=sum(rates),
        guesses=tuple(guesses),
    )


def _without_demand(robot: Robot, profile: Profile) -> Iterator[str]:
    """Yield the components whose CPU neither the robot file nor the profile gives."""
    for entry in robot.components():
        if entry.name not in profile.components and "cpu" not in entry.demand:
            yield f"'{entry.name}'"


def _knows_waits(robot: Robot, profile: Profile) -> Iterator[bool]:
    for entry in robot.components():
        if (known := profile.components.get(entry.name)) is not None:
            yield bool(known.handlers) or not known.timers
            yield from (each.waiting is not None for each in known.handlers.values())
    for connector in robot.all_connectors():
        over = profile.connectors.get(str(connector))
        if over is not None and over.answering is not None:
            yield over.answering.waiting is not None


def _rates(
    robot: Robot, name: str, bag: Mapping[str, ConnectorProfile]
) -> dict[str, float]:
    """Return port of a bridge -> how often a bag has a message for it [Hz]."""
    return {
        connector.between[0].port: bag[str(connector)].rate
        for connector in robot.all_connectors()
        if connector.between[0].component == name and str(connector) in bag
    }


def _at_rates(model: ComponentModel, rates: Mapping[str, float]) -> ComponentModel:
    """Return a model whose timers of some names have other rates [Hz]."""

    def at_rate(entry: TimerModel) -> TimerModel:
        rate = rates.get(entry.timer.name)
        if rate is None:
            return entry
        timer = structs.replace(entry.timer, period=1 / rate)
        return structs.replace(entry, timer=timer)

    return structs.replace(model, timers=tuple(map(at_rate, model.timers)))


def _traffic_of(
    connector: Connector, measured: ConnectorProfile | None
) -> ConnectorProfile:
    if measured is not None and measured.rate:
        return measured
    return ConnectorProfile(messages=connector.rate, size=connector.message)


def _code_of(robot: Robot, entry: ComponentEntry) -> tuple[ComponentCode | None, str]:
    """Return what the class of a component declares, or why it is not known."""
    if not entry.implementation:
        said = f"'{entry.name}' is a program: only its CPU counts, one core at most"
        return None, said
    if (known := robot.code.get(entry.name)) is not None:
        return known, ""
    return None, f"the code of '{entry.name}' is not known: `poise check`"


class _Rated(Struct):
    """A handler while it is put together: how often it runs, and what it sends.

    `of` is its timer, or the port at which it takes or serves. `rate` is how often it
    is due [Hz]: it ran less often where its `time` for a run was longer [s].
    """

    of: str
    rate: float
    work: float
    spread: float
    publishes: dict[str, float]
    calls: dict[str, float]
    joined: dict[str, float] = {}
    started: dict[str, float] = {}
    is_measured: bool = False
    time: float = 0.0
    waiting: float = 0.0
    wait: float = 0.0
    wait_spread: float = 0.0

    @property
    def runs(self) -> float:
        """How often it ran when it was measured [Hz]."""
        return 1 / max(self.time, 1 / self.rate)

    def handler(self) -> HandlerModel:
        names = HandlerModel.__struct_fields__
        return HandlerModel(**{name: getattr(self, name) for name in names})


class _ComponentWork:
    """One component, on its way to a model."""

    def __init__(
        self,
        robot: Robot,
        layout: DeploymentLayout,
        over: Mapping[str, ConnectorProfile],
        entry: ComponentEntry,
        code: ComponentCode | None,
        profile: Profile,
        guess: Callable[[str], None],
    ) -> None:
        self._robot = robot
        self._layout = layout
        self._over = over
        self._entry = entry
        self._code = code
        # an emulated computer of half the speed runs at full speed, half of the time
        self._speed = 1.0 if profile.loops else profile.speed or 1.0
        self._known = profile.components.get(entry.name)
        self._guess = guess
        self._calls = any(
            over[str(connector)].calls
            for connector in robot.all_connectors()
            if connector.between[0].component == entry.name
        )
        self._waits_for_room = False
        for connector in robot.all_connectors():
            source, end = connector.between
            known = robot.code.get(end.component)
            if source.component == entry.name and known and end.port in known.blocks:
                self._waits_for_room = True
                guess(
                    f"'{source}' waits for room in the queue of '{end}' only as "
                    "long as when it was profiled"
                )
        timers = self._timers()
        self._follows_device = (
            bool(timers) and not any(self._coming()) and all(map(self._waits, timers))
        )
        if entry.implementation and timers == [_EVENLY]:
            guess(f"'{entry.name}' has no timer and gets nothing: only its CPU counts")

    def model(self) -> ComponentModel:
        """Return what it does."""
        entry, known = self._entry, self._known
        self._say_late()
        start = known.start if known else _USUAL_START
        timers = {timer.name: self._timer(timer) for timer in self._timers()}
        coming = list(self._coming())
        taken = self._runs((s, at, t.messages) for s, at, t in coming if t.messages)
        for handler in taken.values():
            self._take(handler, known.handlers.get(handler.of) if known else None)
        served = self._runs((s, at, t.calls) for s, at, t in coming if t.calls)
        for slot, _, over in coming:
            if over.calls:
                self._take(served[slot], over.answering)
        others = [*taken.values(), *served.values()]
        unique = list({id(handler): handler for handler in others}.values())
        if answer := self._answer():
            self._take(answer, known.handlers.get(ANSWER) if known else None)
            unique.append(answer)
        if any(handler.is_measured for handler in (*timers.values(), *unique)):
            _share_rest(self.cpu(), [*timers.values(), *unique])
        else:
            self._share_work(list(timers.values()), unique)
        self._feed([*timers.values(), *unique])
        return ComponentModel(
            timers=tuple(
                TimerModel(timer=timer, handler=timers[timer.name].handler())
                for timer in self._timers()
            ),
            takes={slot: handler.handler() for slot, handler in taken.items()},
            serves={slot: handler.handler() for slot, handler in served.items()},
            other=HandlerModel(work=1e-4),
            answer=answer.handler() if answer else None,
            keep=self._keeps(),
            start=(_START[0] * start, _START[1] * start),
            state_size=(known.state if known else 0.0) or entry.state,
            memory=known.memory + known.base
            if known
            else entry.demand.get("memory", 0.0),
            follows_device=self._follows_device,
        )

    def _timers(self) -> list[Timer]:
        timers = self._own_timers()
        if timers or any(traffic.rate for _, _, traffic in self._coming()):
            return timers
        return [_EVENLY] if self.cpu() else []

    def _own_timers(self) -> list[Timer]:
        if self._entry.implementation == BRIDGE:
            return [  # what comes from ROS 2: no component sends it
                Timer(connector.between[0].port, 1 / rate, None)
                for connector in self._robot.all_connectors()
                if connector.between[0].component == self._entry.name
                if (rate := self._over[str(connector)].rate)
            ]
        if self._code is not None and (self._code.timers or not self._known):
            return [Timer(t.name, t.period, t.deadline) for t in self._code.timers]
        measured = self._known.timers if self._known else {}
        return [
            Timer(name, timer.period, timer.period if self._code is None else None)
            for name, timer in measured.items()
        ]

    def _timer(self, timer: Timer) -> _Rated:
        known = self._known
        measured = known.timers.get(timer.name) if known else None
        spread = self._spread(1 / timer.period)
        if measured and measured.median > 0 and measured.p99 > measured.median:
            # what it waited for is in that, too
            spread = min(spread, log(measured.p99 / measured.median) / _P99)
        work = measured.median * self._speed if measured else 0.0
        rated = _Rated(timer.name, 1 / timer.period, work, spread, {}, {})
        if measured and not self._follows_device:
            rated.time = measured.median
        self._take(rated, known.handlers.get(timer.name) if known else None)
        return rated

    def _answer(self) -> _Rated | None:
        """Return what takes the answers of the calls that its code starts."""
        starts = self._code.starts if self._code else {}
        rate = sum(
            self._over[str(connector)].calls
            for connector in self._robot.all_connectors()
            if connector.between[0].component == self._entry.name
            if any(connector.between[0].port in each for each in starts.values())
        )
        if not rate or self._code is None or ANSWER not in self._code.sends:
            return None
        return _Rated(ANSWER, rate, 0.0, self._spread(rate), {}, {})

    def _say_late(self) -> None:
        """Say which timers were late when little else ran, as they wait in their runs.

        What they wait for in calls is simulated, and so is a wait that was measured,
        but for a device.
        """
        for name, run in (self._known.timers if self._known else {}).items():
            taken = self._known.handlers.get(name) if self._known else None
            computes = taken.p99 / self._speed if taken else 0.0
            late = run.missed or 0.0
            if taken and taken.waits and not self._follows_device:
                continue
            if late >= _LATE and computes < run.p99 / 2 and not self._calls:
                self._guess(
                    f"'{self._entry.name}.{name}' missed {late:.0%} of its deadlines "
                    f"when it was profiled: {LEFT_OUT}"
                )

    def _waits(self, timer: Timer) -> bool:
        """Whether its runs take far longer than they compute, and call nobody."""
        run = self._known.timers.get(timer.name) if self._known else None
        taken = self._known.handlers.get(timer.name) if self._known else None
        if run is None or taken is None or self._calls or self._waits_for_room:
            return False
        waited = run.median - taken.p99 / self._speed
        return waited > _WAITED * timer.period

    def _runs(self, coming: Iterable[tuple[str, Place, float]]) -> dict[str, _Rated]:
        """Return slot -> the runs for what comes over it: of alternatives the same."""
        places, rates = {}, dict[Place, float]()
        for slot, place, rate in coming:
            places[slot] = place
            rates[place] = max(rate, rates.get(place, 0.0))
        runs = {
            place: _Rated(place[0], rate, 0.0, self._spread(rate), {}, {})
            for place, rate in rates.items()
        }
        return {slot: runs[place] for slot, place in places.items()}

    def _take(self, handler: _Rated, taken: HandlerProfile | None) -> None:
        """Let a handler take what it was measured to take, if it was."""
        if taken is None:
            return
        handler.is_measured = True
        handler.work = taken.mean
        handler.spread = _spread_of(taken.median or taken.p99, taken.p99)
        if taken.waits and not self._follows_device:
            handler.waiting, handler.wait = taken.waiting or 0.0, taken.wait
            handler.wait_spread = _spread_of(taken.wait, taken.wait_p99)

    def _spread(self, rate: float) -> float:
        """Return how much runs differ, by how much windows with several of them do.

        Windows that have one run more than others differ by that, too: of those with
        most runs the last 5 % and 1 % of all tell more.
        """
        cpu = self._known.cpu if self._known else None
        if cpu is None or not cpu.mean or not cpu.p95:
            return _SPREAD
        runs = rate * WINDOW
        of_windows = max(0.0, cpu.p95 / cpu.mean - 1.0) / _P95
        most = min(_MOST_SPREAD, of_windows * sqrt(max(1.0, runs)))
        count = ceil(runs - _FEW)
        share = min(1.0, runs - count + 1) if count > 1 else min(1.0, runs)
        if share <= _FEW:
            return most
        tail, end = (_NORMAL.inv_cdf(1 - part / share) for part in (0.05, 0.01))
        by_tail = log(max(1.0, cpu.p99 / cpu.p95)) / (end - tail) * sqrt(max(1, count))
        return min(most, max(_LEAST_SPREAD, by_tail))

    def _coming(self) -> Iterator[tuple[str, Place, ConnectorProfile]]:
        """Yield slot, place and traffic of each connector of Poise that ends here."""
        owners = {c.name: a for a in self._robot.architectures for c in a.components}
        counts = Counter[tuple[str, str]]()
        for connector in self._robot.all_connectors():
            source, end = connector.between
            if end.component == self._entry.name and not connector.topic:
                owner = owners[source.component]
                number = counts[end.port, owner.name]
                counts[end.port, owner.name] += 1
                place = end.port, owner.function, number
                yield self._layout.slot_of(connector), place, self._over[str(connector)]

    def _keeps(self) -> list[tuple[list[str], int]]:
        """Return how many messages wait at most, where the class says so, by slots."""
        kept: dict[str, tuple[list[str], int]] = {}
        for connector in self._robot.all_connectors():
            end = connector.between[1]
            keep = self._code.keep.get(end.port) if self._code else None
            if keep is not None and end.component == self._entry.name:
                slots, _ = kept.setdefault(end.port, ([], keep))
                slots.append(self._layout.slot_of(connector))
        return list(kept.values())

    def _share_work(self, timers: list[_Rated], others: list[_Rated]) -> None:
        """Let all handlers together take the CPU that the component takes.

        Timers that seem to take more than all of it have waited: then all runs are
        taken to be alike. So they are where no timer was measured.
        """
        total = self.cpu()
        measured = sum(timer.rate * timer.work for timer in timers)
        rest = sum(handler.rate for handler in others)
        if rest and (measured > total or not measured):
            alike = total / (rest + sum(timer.rate for timer in timers))
            for handler in (*timers, *others):
                handler.work = alike
            return
        if rest:
            by_timers = measured
            for handler in others:
                handler.work = (total - by_timers) / rest
        else:
            by_timers = total
        if measured:
            for timer in timers:
                timer.work *= by_timers / measured
        elif timers:
            for timer in timers:
                timer.work = total / sum(t.rate for t in timers)

    def cpu(self) -> float:
        """Return the mean CPU that it takes [cores of the reference]."""
        if self._known is not None:
            return self._known.cpu.mean + self._known.share
        return self._entry.demand.get("cpu", 0.0) / _HEADROOM

    def _feed(self, handlers: list[_Rated]) -> None:
        """Let a handler send what goes out over each connector."""
        wanted: dict[str, tuple[str, ConnectorProfile]] = {}
        for connector in self._robot.all_connectors():
            end = connector.between[0]
            if end.component == self._entry.name and not connector.topic:
                slot, over = self._layout.slot_of(connector), self._over[str(connector)]
                if slot not in wanted or over.rate > wanted[slot][1].rate:
                    wanted[slot] = end.port, over
        sends = self._code.sends if self._code else {}
        for slot, (port, over) in wanted.items():
            may = [handler for handler in handlers if port in sends.get(handler.of, ())]
            calling = _feeding(may or handlers, over.calls)
            sending = _feeding(may or handlers, over.messages)
            if calling is None or sending is None:
                if over.rate:
                    self._guess(f"nothing sends over '{slot}': no handler runs")
            elif not over.rate:
                self._guess(f"the traffic over '{slot}' is not known: it has none here")
            else:
                if over.calls:
                    starts = self._code.starts if self._code else {}
                    waits = starts.get(calling.of, {}).get(port)
                    calls = {None: calling.calls, True: calling.joined}
                    each = _each(over.calls / calling.runs)
                    calls.get(waits, calling.started)[slot] = each
                if over.messages:  # one-way calls are sent like messages
                    sending.publishes[slot] = _each(over.messages / sending.runs)


def _spread_of(median: float, p99: float) -> float:
    """Return the spread of values that are distributed log-normally."""
    return min(_MOST_SPREAD, log(max(1.0, p99 / (median or 1.0))) / _P99)


def _share_rest(total: float, handlers: list[_Rated]) -> None:
    """Let what was not measured take the rest of the CPU; all, if everything was."""
    rest = total - sum(handler.runs * handler.work for handler in handlers)
    unknown = [handler for handler in handlers if not handler.is_measured] or handlers
    for handler in unknown:
        handler.work += max(0.0, rest) / sum(other.runs for other in unknown)


def _each(often: float) -> float:
    """Return how often a run sends: a whole number where it is one but for counting."""
    whole = round(often)
    return float(whole) if abs(often - whole) <= _COUNTED * whole else often


def _feeding(handlers: list[_Rated], rate: float) -> _Rated | None:
    """Return the handler that runs just as often, or a little more; else the most."""
    enough = [handler for handler in handlers if handler.rate * _AS_OFTEN >= rate]
    if enough:
        return min(enough, key=lambda handler: handler.rate)
    return max(handlers, key=lambda handler: handler.rate, default=None)
