"""Calibrates a robot: the speeds of its computers and the costs of its connectors."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import get_args

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import RunError, UsageError
from poise.estimate.profiles import Costs, KindCosts
from poise.manage.agent_connections.statuses import Statuses, located
from poise.manage.journal import Journal
from poise.manage.observe.sample_recording import Recording
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.runtime.calibration import SCORES
from poise.session import Check, nothing
from poise.session.arguments import check_duration, check_robot
from poise.session.launch.start import Sampling, started
from poise.session.profiling.stored_profiles import (
    check_keepable,
    own_profile,
    steady,
    store_of,
    write_profile,
)
from poise.wire.records.deployment_records import ConnectorKind
from poise.wire.records.status_records import AgentSample, ContainerSample

SIZES = (100, 65_536)
"""[bytes] Small and large; the cost of a byte is the slope between them."""
KINDS: tuple[str, ...] = get_args(ConnectorKind)
_MODULE = "poise.runtime.calibration"


class Pair(Struct, frozen=True):
    """Two components that communicate, and how."""

    kind: str
    how: str
    size: int

    @property
    def name(self) -> str:
        """The name of their architecture."""
        return f"{self.kind}-{self.how}-{self.size}"

    @property
    def containers(self) -> tuple[str, ...]:
        """The names of their containers."""
        if self.kind == "direct":
            return (self.name,)
        return (f"{self.name}.{self.name}-source", f"{self.name}.{self.name}-target")


PAIRS = tuple(
    Pair(kind, how, size)
    for kind in KINDS
    for how in ("call", "message")
    for size in SIZES
)
EMPTY = "empty"
"""A container that does nothing, like a target without traffic."""
TICKING = "ticking"
"""A container whose component has an empty timer, like a silent source."""


def yardsticks(robot: Robot) -> tuple[Robot, dict[str, str]]:
    """Return a robot with a yardstick on each of `robot`'s computers; its placement."""
    components = {f"yardstick-{c.name}": c.name for c in robot.hosts}
    architecture = Architecture(
        name="yardsticks",
        function="yardsticks",
        components=tuple(
            ComponentEntry(name=n, implementation=f"{_MODULE}:Yardstick", isolated=True)
            for n in components
        ),
    )
    return _bare(robot, (architecture,)), components


def pairs(robot: Robot, here: str, there: str) -> tuple[Robot, dict[str, str]]:
    """Return a robot with pairs on and between two of `robot`'s computers."""
    placement = {}
    architectures = list(_architectures())
    for pair in PAIRS:
        placement[f"{pair.name}-source"] = here
        placement[f"{pair.name}-target"] = there if pair.kind == "remote" else here
    for name, implementation in (
        (EMPTY, "poise.runtime.component.component:Component"),
        (TICKING, f"{_MODULE}:Ticker"),
    ):
        placement[name] = here
        silent = ComponentEntry(name=name, implementation=implementation)
        architectures.append(
            Architecture(name=name, function=name, components=(silent,))
        )
    return _bare(robot, tuple(architectures)), placement


def _architectures() -> Iterator[Architecture]:
    for pair in PAIRS:
        is_call = pair.how == "call"
        classes = ("Asker", "Echoer") if is_call else ("Talker", "Listener")
        ends = (f"{pair.name}-source", f"{pair.name}-target")
        source, target = (ConnectorEnd(name, "port") for name in ends)
        yield Architecture(
            name=pair.name,
            function=pair.name,
            components=tuple(
                ComponentEntry(
                    name=name,
                    implementation=f"{_MODULE}:{class_}",
                    isolated=pair.kind != "direct",
                    parameters={"size": pair.size},
                )
                for name, class_ in zip(ends, classes, strict=True)
            ),
            connectors=(Connector(between=(source, target)),),
        )


def _bare(robot: Robot, architectures: tuple[Architecture, ...]) -> Robot:
    """Return the robot's computers and links with other software."""
    return replace(
        robot,
        architectures=architectures,
        connectors=(),
        chains=(),
        tasks=(),
        together=(),
        apart=(),
        simulator=None,
        workload=None,
    )


def costs_of(
    samples: Iterable[AgentSample], speeds: Mapping[str, float]
) -> dict[str, KindCosts]:
    """Return the costs of connectors by kind; remote only with two computers."""
    sources, targets, computers = _uses(samples, speeds)
    kinds = KINDS if len(computers) > 1 else KINDS[:-1]
    costs = {
        kind: KindCosts(source=_end(sources, kind), target=_end(targets, kind))
        for kind in kinds
    }
    for kind, both in costs.items():
        if kind != "direct" and not both.source.call * both.source.message:
            raise RunError(
                f"the cost of a {kind} connector cannot be separated from other load; "
                "try again on a less busy machine, or with a longer --for"
            )
    return costs


def _uses(
    samples: Iterable[AgentSample], speeds: Mapping[str, float]
) -> tuple[dict[Pair, float], dict[Pair, float], set[str]]:
    """Return the CPU time of a call or message at either end [s], and the computers."""
    series: dict[str, list[ContainerSample]] = defaultdict(list)
    where: dict[str, str] = {}
    for sample in samples:
        for container in sample.containers:
            series[container.name].append(container)
            where[container.name] = sample.computer
    for name in (EMPTY, TICKING, *(name for pair in PAIRS for name in pair.containers)):
        if name not in series or series[name][-1].at <= series[name][0].at:
            raise RunError(f"container '{name}' sent no samples; try again")
    used = {name: _cores(each) for name, each in series.items()}
    sources, targets = {}, {}
    for pair in PAIRS:
        source = series[pair.containers[0]]
        seconds = source[-1].at - source[0].at
        count = _count(source[-1]) - _count(source[0])
        if count <= 0:
            raise RunError(f"the pair '{pair.name}' did not communicate; try again")
        spent = [
            max(0.0, used[name] - used[silent]) * seconds / count * speeds[where[name]]
            for name, silent in zip(pair.containers, (TICKING, EMPTY), strict=False)
        ]
        sources[pair], targets[pair] = spent[0], sum(spent[1:])
    return sources, targets, set(where.values())


def _cores(samples: Sequence[ContainerSample]) -> float:
    """Return the CPU of a container [cores]."""
    return statistics.median(
        (b.cpu - a.cpu) / (b.at - a.at) for a, b in pairwise(samples) if b.at > a.at
    )


def _count(sample: ContainerSample) -> int:
    return sum(each.calls + each.messages for each in sample.connectors)


def _end(uses: Mapping[Pair, float], kind: str) -> Costs:
    """Fit a line through small and large sizes; calls and messages share its slope."""
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


_WARM_UP = 1.0
_SPREAD = 0.05
"""The quickest runs of repeated measurements differ by at most this share."""


class ComputerSpeed(Struct, frozen=True):
    """The speed of a computer.

    Parameters
    ----------
    loops
        Work done per second of CPU time, when nothing disturbs it [1/s].
    speed
        Relative to the reference computer; None: it is emulated on this machine.
    """

    loops: float
    speed: float | None


class Calibration(Struct, frozen=True, kw_only=True):
    """The result of a calibration.

    Parameters
    ----------
    reference
        The computer that `speed` refers to.
    computers
        Computer -> its speed.
    costs
        Kind of connector (``direct``, ``local``, ``remote``) -> CPU time of each end.
    busy
        Why the result is discarded, one sentence each; empty: it is kept.
    kept
        Whether the costs were written to the store, and to the profile if there is one.
    """

    reference: str
    computers: Mapping[str, ComputerSpeed]
    costs: Mapping[str, KindCosts]
    busy: tuple[str, ...] = ()
    kept: bool = False


def calibrate(
    robot: Robot,
    *,
    reference: str | None = None,
    seconds: float = 8.0,
    force: bool = False,
    check: Check = nothing,
) -> Calibration:
    """Measure how fast the robot's computers are, and what its connectors cost.

    Parameters
    ----------
    reference
        The computer that speeds are relative to; None: the first.
    seconds
        Duration of each of the two measurements [s].
    force
        Whether to keep the result of a busy machine, too.
    check
        Called several times a second; may raise to end the measurement.

    Raises
    ------
    UsageError
        There is no such computer, or the result could not be written.
    RunError
        The computers could not be measured.
    """
    check_robot(robot)
    check_duration("a measurement", seconds)
    names = [c.name for c in robot.hosts]
    chosen = reference or names[0]
    if chosen not in names:
        raise UsageError(f"--reference {chosen}: the computers are {', '.join(names)}")
    check_keepable(robot)
    own_profile(robot)  # or its costs would be written into another robot's
    with steady(robot):
        computers, busy = _speeds(robot, chosen, seconds, check)
        costs, more = _costs(robot, seconds, check)
    doubts = tuple(dict.fromkeys(filter(None, (*busy, more))))
    is_kept = force or not doubts
    if is_kept:
        _keep(robot, costs)
    return Calibration(
        reference=chosen, computers=computers, costs=costs, busy=doubts, kept=is_kept
    )


def _keep(robot: Robot, costs: Mapping[str, KindCosts]) -> None:
    """Write the costs to the store, from which later profiles take them, and now."""
    with store_of(robot) as store:
        store.add_costs(robot.name, costs)
    profile = own_profile(robot)
    if profile is not None:
        write_profile(robot, replace(profile, costs=costs))


def _speeds(
    robot: Robot, reference: str, seconds: float, check: Check
) -> tuple[dict[str, ComputerSpeed], list[str]]:
    """Return the speeds, and why they are doubtful."""
    bare, placement = yardsticks(robot)
    journal = Journal(":memory:")
    with started(bare, placement, journal, nothing, check=check) as up:
        up.watch(_WARM_UP)
        up.watch(seconds)
        measured = _measures(up.live.agents.statuses())
    if reference not in measured:
        raise RunError(f"'{reference}' was too busy to be measured; try again")
    unit = max(measured[reference]) / robot.computer(reference).speed
    speeds, doubts = {}, []
    for computer in robot.hosts:
        scores = measured.get(computer.name, ())
        loops = max(scores, default=0.0)
        speeds[computer.name] = ComputerSpeed(
            loops, loops / unit if computer.address else None
        )
        doubts.append(_doubt(computer.name, scores))
    return speeds, doubts


def _measures(statuses: Statuses) -> dict[str, tuple[float, ...]]:
    """Return computer -> the largest score of each series of its yardstick."""
    return {
        computer: tuple(component.measures[each].maximum for each in SCORES)
        for computer, component in located(statuses)
        if component.measures.keys() >= set(SCORES)
    }


def _doubt(computer: str, scores: Sequence[float]) -> str:
    """Return why a computer's speed is discarded; empty: it is."""
    if not scores:
        return f"computer '{computer}' was too busy to be measured"
    spread = max(scores) / min(scores) - 1
    if spread <= _SPREAD:
        return ""
    return (
        f"the speed of computer '{computer}' was not steady: the quickest runs of "
        f"{len(scores)} series differ by {spread:.0%}"
    )


def _costs(
    robot: Robot, seconds: float, check: Check
) -> tuple[dict[str, KindCosts], str]:
    """Return the costs of connectors on the first and last computer, and a doubt."""
    bare, placement = pairs(robot, robot.hosts[0].name, robot.hosts[-1].name)
    recording = Recording()
    with started(
        bare, placement, Journal(":memory:"), nothing, Sampling(recording.add), check
    ) as up:
        up.watch(_WARM_UP)
        up.computers.begin()
        recording.drain()
        up.watch(seconds)
        samples = recording.drain()
        busy = up.computers.end()
    # the CPU time of an emulated computer is this machine's
    speeds = {c.name: c.speed if c.address else 1.0 for c in robot.computers}
    return costs_of(samples, speeds), busy
