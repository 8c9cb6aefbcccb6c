"""Turns repeated measurements of single architectures into a profile. Pure."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise

from msgspec import Struct, structs

from poise.errors import last_error
from poise.estimate.online import CPU_LEFT, Reading, window_between
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Distribution,
    HandlerProfile,
    TimerProfile,
    distribution_of,
    scaled,
)
from poise.manage.agent_connections.statuses import (
    Statuses,
    components_of,
    connectors_of,
)
from poise.manage.observe.estimates import traffic_between, with_cpu_left
from poise.model.robot import Robot
from poise.session.profiling.rig import EMPTY, ProfilingRig
from poise.session.render.tables import failed_calls
from poise.units import counted
from poise.wire.records.status_records import (
    AgentSample,
    ComponentStatus,
    ContainerSample,
    Summary,
)


class MeasuredUsage(Struct, frozen=True, kw_only=True):
    """Usage over a time, in CPU of the computers themselves."""

    cpu: Mapping[str, Distribution]  # Component -> its own CPU [cores]
    # Container -> its own CPU beyond that of its components [cores]
    rest: Mapping[str, float]
    members: Mapping[str, tuple[str, ...]]  # Container -> its components
    memory: Mapping[str, float]  # Container -> peak of its memory [bytes]
    agents: Mapping[str, float]  # Computer -> CPU of its agent [cores]
    # Computer -> CPU of all programs [cores]; without those whose agent cannot tell
    busy: Mapping[str, float] = {}
    # Traffic of connectors, by their run-time names
    connectors: Mapping[str, ConnectorProfile]
    # Component -> share of the arrived jobs that were not done for lack of CPU
    undone: Mapping[str, float]


def measure(samples: Iterable[AgentSample], robot: Robot) -> MeasuredUsage:
    """Return the usage from the first to the last of `samples`."""
    by_agent: dict[str, list[AgentSample]] = defaultdict(list)
    by_container: dict[str, list[ContainerSample]] = defaultdict(list)
    cores, had_cpu_left = {c.name: c.own_cores for c in robot.computers}, Counter[str]()
    for sample in samples:
        earlier = by_agent[sample.computer]
        before = earlier[-1] if earlier else None
        there = with_cpu_left(before, sample, cores.get(sample.computer, 0.0))
        earlier.append(sample)
        for container in sample.containers:
            by_container[container.name].append(container)
            had_cpu_left[container.name] += container.pid in there
    cpu: dict[str, Distribution] = {}
    undone: dict[str, float] = {}
    rest, members, memory = {}, {}, {}
    connectors: dict[str, ConnectorProfile] = {}
    for name, seen in by_container.items():
        readings = _readings(seen)
        cpu |= {c: _distribution(r) for c, r in readings.items()}
        had_cpu = had_cpu_left[name] >= CPU_LEFT * (len(seen) - 1)
        undone |= {c: 0.0 if had_cpu else _undone(r) for c, r in readings.items()}
        members[name] = tuple(readings)
        rest[name] = _rate([(s.at, s.cpu) for s in seen]) - sum(
            _rate([(r.at, r.cpu) for r in each]) for each in readings.values()
        )
        memory[name] = max(float(s.memory) for s in seen)
        for connector, profile in _connector_usages(seen).items():
            connectors[connector] = _busier(connectors.get(connector), profile)
    return MeasuredUsage(
        cpu=cpu,
        rest=rest,
        members=members,
        memory=memory,
        agents={
            n: _rate([(s.at, s.cpu) for s in each]) for n, each in by_agent.items()
        },
        busy={
            n: _rate([(s.at, s.busy) for s in each if s.busy is not None])
            for n, each in by_agent.items()
            if any(s.busy is not None for s in each)
        },
        connectors=connectors,
        undone=undone,
    )


def _readings(seen: Iterable[ContainerSample]) -> dict[str, list[Reading]]:
    found: dict[str, list[Reading]] = defaultdict(list)
    for sample in seen:
        for each in sample.components:
            reading = Reading(sample.at, each.cpu, each.wait, each.asked, each.done)
            found[each.name].append(reading)
    return found


def _distribution(readings: list[Reading]) -> Distribution:
    windows = [window_between(a, b) for a, b in pairwise(readings)]
    kept = [w for w in windows if w is not None]
    if not kept:
        return Distribution()
    length = sum(w.seconds for w in kept) / len(kept)
    distribution = distribution_of([w.cpu / w.seconds for w in kept], length)
    # the mean of all windows is exact although their lengths differ
    mean = sum(w.cpu for w in kept) / sum(w.seconds for w in kept)
    return structs.replace(distribution, mean=mean)


def _undone(readings: list[Reading]) -> float:
    asked = readings[-1].asked - readings[0].asked
    done = readings[-1].done - readings[0].done
    # up to two are under way
    return max(0.0, (asked - done - 2) / asked) if asked > 0 else 0.0


def _rate(points: list[tuple[float, float]]) -> float:
    """Return the growth of a counter [1/s], from (time [s], count) first to last."""
    (began, first), (ended, last) = points[0], points[-1]
    return (last - first) / (ended - began) if ended > began else 0.0


def _connector_usages(seen: list[ContainerSample]) -> dict[str, ConnectorProfile]:
    first = {c.name: (seen[0].at, c) for c in seen[0].connectors}
    found = {}
    for now in seen[-1].connectors:
        if now.name in first:
            began, before = first[now.name]
            found[now.name] = traffic_between(before, now, seen[-1].at - began)
    return found


def _busier(one: ConnectorProfile | None, other: ConnectorProfile) -> ConnectorProfile:
    """Combine the counts of both ends: each counts both directions."""
    if one is None:
        return other
    return ConnectorProfile(
        calls=max(one.calls, other.calls),
        messages=max(one.messages, other.messages),
        size=max(one.size, other.size),
    )


AGREE_SHARE = 0.05
AGREE_CORES = 0.01
"""Repeated means agree if they differ by less than either of these."""
_UNDONE = 0.02


class Observed(Struct, frozen=True, kw_only=True):
    """One measurement of one architecture."""

    measured: MeasuredUsage
    statuses: Statuses  # The agents' last statuses, after deactivation
    # Their last statuses before deactivation, which ends commands
    working: Statuses = {}
    invalid: str = ""  # Why the measurement is invalid; empty: it is valid


class Figures(Struct, frozen=True, kw_only=True):
    """The figures of one architecture; see `Profile` for the fields."""

    components: Mapping[str, ComponentProfile]
    connectors: Mapping[str, ConnectorProfile]
    agent: float


def disagreeing(runs: Sequence[Observed], names: Iterable[str]) -> list[str]:
    """Return the components whose means differ too much, or that did not keep up."""
    return [name for name in names if not _is_stable(runs, name)]


def how_full(runs: Iterable[Observed], rig: ProfilingRig) -> float:
    """Return the share of CPU used in the fullest run; 0: the agent cannot tell."""
    cores = rig.robot.computer(rig.computer).own_cores
    return max(run.measured.busy.get(rig.computer, 0.0) for run in runs) / cores


class WhatFailed(Struct, frozen=True):
    """What failed during a measurement, for people.

    `always`: the components of which something failed each time: it is not known what
    they need when it does not.
    """

    sentences: tuple[str, ...] = ()
    always: frozenset[str] = frozenset()


def failures(robot: Robot, run: Observed, names: Collection[str]) -> WhatFailed:
    """Return what failed of these components in a run: their handlers and calls."""
    always, sentences = set(), []
    for component in components_of(run.working):
        if component.errors and component.name in names:
            last = last_error(component.error)
            errors = counted(component.errors, "error")
            sentences.append(f"component '{component.name}': {errors}, last {last}")
            if any(e.where not in component.work for e in component.error_counts):
                always.add(component.name)
    joined = {
        str(c): {end.component for end in c.between}.intersection(names)
        for c in robot.all_connectors()
    }
    ends = [end for end in connectors_of(run.working) if joined.get(end.name)]
    for end in ends:
        if end.end != "target" and 0 < end.calls <= end.errors:
            always |= joined[end.name]
    return WhatFailed((*sentences, *failed_calls(ends)), frozenset(always))


def figures(
    robot: Robot,
    rig: ProfilingRig,
    runs: Sequence[Observed],
    apart: Observed,
    *,
    versions: Mapping[str, str],
    speed: float,
) -> Figures:
    """Return the figures of an architecture."""
    names = rig.measured

    def total(run: Observed) -> float:
        return sum(run.measured.cpu[n].mean for n in names if n in run.measured.cpu)

    typical = sorted(runs, key=total)[(len(runs) - 1) // 2]
    memory = _memory(typical, apart, names)
    shares = _shares(typical, apart, names)
    states = {s.name: s for s in components_of(apart.statuses)}
    timed = {s.name: s for s in components_of(typical.statuses)}
    timed |= {s.name: s for s in components_of(typical.working)}
    # with others in its container it waits for the interpreter, too
    alone = {s.name: s for s in components_of(apart.working)}
    found = {}
    for name in names:
        own, base = memory[name]
        found[name] = ComponentProfile(
            version=versions[name],
            cpu=scaled(typical.measured.cpu.get(name, Distribution()), speed),
            share=speed * shares[name],
            memory=own,
            base=base,
            state=float(states[name].snapshot) if name in states else 0.0,
            start=timed[name].start if name in timed else 0.0,
            timers=_timers(timed.get(name)),
            handlers={
                what: taken
                for what, taken in _taken(timed.get(name), alone.get(name), speed)
                if what not in typical.measured.connectors  # calls: `_connectors`
            },
            repeat=speed * _spread(_means(runs, name)),
            stable=_is_stable(runs, name),
        )
    return Figures(
        components=found,
        connectors=dict(_connectors(robot, rig, typical, apart, speed)),
        agent=speed * typical.measured.agents.get(rig.computer, 0.0),
    )


def _is_stable(runs: Sequence[Observed], name: str) -> bool:
    means = _means(runs, name)
    if not means or any(run.measured.undone.get(name, 0) > _UNDONE for run in runs):
        return False
    return _spread(means) <= max(AGREE_SHARE * max(means), AGREE_CORES)


def _means(runs: Sequence[Observed], name: str) -> list[float]:
    return [r.measured.cpu[name].mean for r in runs if name in r.measured.cpu]


def _spread(means: Sequence[float]) -> float:
    return max(means, default=0.0) - min(means, default=0.0)


def _shares(
    typical: Observed, apart: Observed, names: Sequence[str]
) -> dict[str, float]:
    """Return each component's part of what containers used beyond their components.

    Apart, the container of one with threads or processes of its own uses more than an
    empty one: so much of it is that component's, and the rest is everybody's alike.
    """
    alone = _by_component(apart.measured, apart.measured.rest)
    floor = alone.get(EMPTY, 0.0)
    found: dict[str, float] = {}
    for container, members in typical.measured.members.items():
        rest = max(0.0, typical.measured.rest[container])
        own = {name: max(0.0, alone.get(name, 0.0) - floor) for name in members}
        total = sum(own.values())
        part = min(1.0, rest / total) if total else 0.0
        alike = max(0.0, rest - total) / len(members)
        found |= {name: part * amount + alike for name, amount in own.items()}
    return {name: found.get(name, 0.0) for name in names}


def _memory(
    typical: Observed, apart: Observed, names: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Return the memory that each component adds, and its part of the container's.

    Apart, each component also has the libraries that a shared container has once. Their
    size is the difference between the sum and the shared container.
    """
    alone = _by_component(apart.measured, apart.measured.memory)
    floor = alone.get(EMPTY, 0.0)
    found: dict[str, tuple[float, float]] = {}
    for container, members in typical.measured.members.items():
        here = [name for name in members if name in names]
        if not here:
            continue
        own = {name: max(0.0, alone.get(name, 0.0) - floor) for name in here}
        together = max(0.0, typical.measured.memory[container] - floor)
        common = 0.0
        if len(here) > 1:
            common = max(0.0, sum(own.values()) - together) / (len(here) - 1)
            common = min([common, *own.values()])
        base = (floor + common) / len(here)
        found |= {name: (amount - common, base) for name, amount in own.items()}
    return {name: found.get(name, (0.0, 0.0)) for name in names}


def _by_component(
    measured: MeasuredUsage, figures: Mapping[str, float]
) -> dict[str, float]:
    """Return component -> its container's figure, for those that have their own."""
    return {
        members[0]: figures.get(container, 0.0)
        for container, members in measured.members.items()
        if len(members) == 1
    }


def _timers(status: ComponentStatus | None) -> dict[str, TimerProfile]:
    return {
        timer.name: TimerProfile(
            period=timer.period,
            median=timer.duration.median,
            p99=timer.duration.p99,
            maximum=timer.duration.maximum,
            missed=(
                None if timer.deadline is None else timer.missed / (timer.releases or 1)
            ),
        )
        for timer in (status.timers if status else ())
    }


def _taken(
    status: ComponentStatus | None, alone: ComponentStatus | None, speed: float
) -> Iterator[tuple[str, HandlerProfile]]:
    """Yield what a component's handlers take, and over connectors their calls."""
    for name, taken in sorted(status.work.items() if status else ()):
        if taken.count:
            wait = alone.waits.get(name, Summary()) if alone else Summary()
            runs = alone.work.get(name, Summary()) if alone else Summary()
            handler = HandlerProfile(
                mean=speed * taken.mean,
                median=speed * taken.median,
                p99=speed * taken.p99,
                waiting=wait.count / runs.count if runs.count else None,
                wait=wait.median,
                wait_p99=wait.p99,
            )
            yield name, handler


def _connectors(
    robot: Robot, rig: ProfilingRig, typical: Observed, apart: Observed, speed: float
) -> Iterator[tuple[str, ConnectorProfile]]:
    """Yield the connectors that end at `names`: rates as used, sizes as encoded."""
    sizes = _sizes(apart.statuses)
    answering = {
        name: taken
        for status in components_of(apart.working)
        for name, taken in _taken(status, status, speed)
    }
    for connector in robot.all_connectors():
        if connector.between[1].component not in rig.measured:
            continue
        key = rig.played.get(str(connector), str(connector))
        used = typical.measured.connectors.get(key)
        encoded = apart.measured.connectors.get(key)
        if used is not None and used.rate:
            size = sizes.get(key, Summary())
            profile = structs.replace(
                used,
                size=encoded.size if encoded else used.size,
                median=size.median,
                p99=size.p99,
                largest=size.maximum,
                answering=answering.get(key),
            )
            yield str(connector), profile


def _sizes(statuses: Statuses) -> dict[str, Summary]:
    """Return the sizes of connectors' traffic, from the end that counted the most."""
    found: dict[str, Summary] = {}
    for end in connectors_of(statuses):
        known = found.setdefault(end.name, end.size)
        found[end.name] = max(known, end.size, key=lambda each: each.count)
    return found
