"""Turns samples into figures of components and connectors over a time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from itertools import pairwise

from msgspec import Struct, structs

from poise.estimate.demand_windows import Reading, window_between
from poise.estimate.profile import ConnectorProfile
from poise.estimate.profile.distribution import Distribution, distribution_of
from poise.manage.observe.estimates import traffic_between
from poise.wire.records.samples import AgentSample, ContainerSample


class MeasuredUsage(Struct, frozen=True, kw_only=True):
    """Usage over a time, in CPU of the computers themselves.

    Parameters
    ----------
    cpu
        Component -> its own CPU [cores].
    rest
        Container -> its own CPU beyond that of its components [cores].
    members
        Container -> its components.
    memory
        Container -> peak of its memory [bytes].
    agents
        Computer -> CPU of its agent [cores].
    connectors
        Traffic of connectors, by their run-time names.
    undone
        Component -> share of the arrived jobs that were not done.
    """

    cpu: Mapping[str, Distribution]
    rest: Mapping[str, float]
    members: Mapping[str, tuple[str, ...]]
    memory: Mapping[str, float]
    agents: Mapping[str, float]
    connectors: Mapping[str, ConnectorProfile]
    undone: Mapping[str, float]


def measure(samples: Iterable[AgentSample]) -> MeasuredUsage:
    """Return the usage from the first to the last of `samples`."""
    by_agent: dict[str, list[AgentSample]] = defaultdict(list)
    by_container: dict[str, list[ContainerSample]] = defaultdict(list)
    for sample in samples:
        by_agent[sample.computer].append(sample)
        for container in sample.containers:
            by_container[container.name].append(container)
    cpu: dict[str, Distribution] = {}
    undone: dict[str, float] = {}
    rest, members, memory = {}, {}, {}
    connectors: dict[str, ConnectorProfile] = {}
    for name, seen in by_container.items():
        readings = _readings(seen)
        cpu |= {c: _distribution(r) for c, r in readings.items()}
        undone |= {c: _undone(r) for c, r in readings.items()}
        members[name] = tuple(readings)
        rest[name] = _rate([(s.at, s.cpu) for s in seen]) - sum(
            _rate([(r.at, r.cpu) for r in each]) for each in readings.values()
        )
        memory[name] = max(float(s.memory) for s in seen)
        for connector, profile in _connectors(seen).items():
            connectors[connector] = _busier(connectors.get(connector), profile)
    return MeasuredUsage(
        cpu=cpu,
        rest=rest,
        members=members,
        memory=memory,
        agents={
            n: _rate([(s.at, s.cpu) for s in each]) for n, each in by_agent.items()
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


def _connectors(seen: list[ContainerSample]) -> dict[str, ConnectorProfile]:
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
