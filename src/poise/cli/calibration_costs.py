"""From what pairs that talk used to what a kind of connector costs. Pure.

A call costs what its pair uses more than two containers of the same kind that are
silent: the source's has the same steps, the target's does nothing. So the steps and
what containers use anyway cancel out, and what is left is the call: encoding it, waking
the other end, and all that is cold by then, for whoever talks in steps talks so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct

from poise.cli.calibration_robots import EMPTY, KINDS, PAIRS, SIZES, TICKING, Pair
from poise.errors import RunError
from poise.estimate.profile import Costs, KindCosts
from poise.wire.samples import AgentSample, ContainerSample


class Use(Struct, frozen=True):
    """CPU time of one call or message at either end [s]."""

    source: float
    target: float


def costs_of(
    samples: Iterable[AgentSample], speeds: Mapping[str, float]
) -> dict[str, KindCosts]:
    """Return what connectors cost, by kind; remote only when two computers took part.

    Parameters
    ----------
    samples
        Of the robot that `calibration_robots.pairs` makes, from first to last.
    speeds
        Computer -> what turns its CPU time into the reference computer's.

    Raises
    ------
    RunError
        A container told nothing.
    """
    uses, computers = _uses(samples, speeds)
    kinds = KINDS if len(computers) > 1 else KINDS[:-1]
    return {kind: _fitted(uses, kind) for kind in kinds}


def _uses(
    samples: Iterable[AgentSample], speeds: Mapping[str, float]
) -> tuple[dict[Pair, Use], set[str]]:
    first: dict[str, ContainerSample] = {}
    last: dict[str, ContainerSample] = {}
    where: dict[str, str] = {}
    for sample in samples:
        for container in sample.containers:
            first.setdefault(container.name, container)
            last[container.name] = container
            where[container.name] = sample.computer
    for name in (EMPTY, TICKING, *(name for pair in PAIRS for name in pair.containers)):
        if name not in last or last[name].at <= first[name].at:
            raise RunError(f"container '{name}' told nothing; try again")
    used = {
        name: (last[name].cpu - each.cpu) / (last[name].at - each.at)
        for name, each in first.items()
        if last[name].at > each.at
    }
    found = {}
    for pair in PAIRS:
        source = pair.containers[0]
        seconds = last[source].at - first[source].at
        count = _count(last[source]) - _count(first[source])
        if count <= 0:
            raise RunError(f"the pair '{pair.name}' did not talk; try again")
        spent = [
            max(0.0, used[name] - used[silent]) * seconds / count * speeds[where[name]]
            for name, silent in zip(pair.containers, (TICKING, EMPTY), strict=False)
        ]
        found[pair] = Use(spent[0], sum(spent[1:]))
    return found, set(where.values())


def _count(sample: ContainerSample) -> int:
    return sum(each.calls + each.messages for each in sample.connectors)


def _fitted(uses: Mapping[Pair, Use], kind: str) -> KindCosts:
    return KindCosts(
        source=_end({p: use.source for p, use in uses.items()}, kind),
        target=_end({p: use.target for p, use in uses.items()}, kind),
    )


def _end(uses: Mapping[Pair, float], kind: str) -> Costs:
    """Return the line through small and large ones; bytes cost alike in both."""
    small, large = SIZES
    calls = [uses[Pair(kind, "call", size)] for size in SIZES]
    messages = [uses[Pair(kind, "message", size)] for size in SIZES]
    slopes = [(b - a) / (large - small) for a, b in (calls, messages)]
    byte = max(0.0, sum(slopes) / len(slopes))
    return Costs(
        call=max(0.0, calls[0] - small * byte),
        message=max(0.0, messages[0] - small * byte),
        byte=byte,
    )
