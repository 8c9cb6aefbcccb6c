"""How old the data of chains gets on a placement, and how late timers are.

What components do is simulated several times over; the figures are means over these
runs. No manager and no agent runs, and nothing moves or breaks: a run of a handler
takes a few microseconds, so that a placement can be looked at before anything runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

from msgspec import Struct, structs

from poise.estimate.demands import kinds_together
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation
from poise.model.robot import Chain, Robot
from poise.runtime.component.ports import Timer
from poise.simulation._engine import Engine, Executor
from poise.simulation.choices import Choices
from poise.simulation.component_models import ComponentModel, HandlerModel, TimerModel
from poise.simulation.link_models import links_of, set_links
from poise.simulation.workload import SimulatedWork
from poise.wire.records.status_records import ChainStatus, Summary, TimerStatus

_CORES = 4.0
_USUAL = ComponentModel()
_WEIGHT = 100.0
_SAMPLES_EVERY = 0.1
_REFILLED_EVERY = 0.01
"""An emulated computer gets its share of CPU this often [s], from any moment on."""


class PlacedComponents:
    """The components of a placement, at work.

    `placement`: component -> computer; of all that runs.
    `work`: what the components do.
    `seed`: how long handlers take is drawn, when emulated computers get their shares,
    and the phases of devices.
    """

    def __init__(
        self,
        robot: Robot,
        placement: Mapping[str, str],
        work: SimulatedWork,
        seed: int = 0,
    ) -> None:
        self._engine = Engine(seed)
        self._executors: dict[str, Executor] = {}
        set_links(self._engine, links_of(robot))
        self._add_components(robot, placement, work, Choices(seed))
        for executor in self._executors.values():
            executor.activate()

    @property
    def now(self) -> float:
        """Virtual time that has passed [s]."""
        return self._engine.now

    def run(self, until: float) -> None:
        """Let virtual time pass until a moment [s]."""
        while self._engine.run(until) < until or self._engine.notify():
            self._engine.notify()

    def chains(self, component: str) -> tuple[ChainStatus, ...]:
        """Return how old the data was that a component used."""
        return self._executors[component].chains()

    def timers(self, component: str) -> tuple[TimerStatus, ...]:
        """Return how a component's timers kept their rates."""
        return self._executors[component].timers(self.now)

    def _add_components(
        self,
        robot: Robot,
        placement: Mapping[str, str],
        work: SimulatedWork,
        choices: Choices,
    ) -> None:
        engine, kinds = self._engine, kinds_together(robot)
        devices = choices.random("devices")
        incarnations = [
            Incarnation(component=c, computer=h) for c, h in placement.items()
        ]
        deployments = DeploymentLayout(robot, "").deployments(
            Desired(coming=tuple(incarnations)), {}
        )
        agent = _agent(work.agent)
        for computer in robot.computers:
            refilled = choices.random("refills").uniform(0.0, _REFILLED_EVERY)
            self.run(self.now + refilled)
            cores = computer.capacity.get("cpu", _CORES)
            is_emulated = computer.address is None
            cpu = engine.cpu(cores, computer.speed, is_emulated=is_emulated)
            own = engine.container(cpu, computer.name, _nothing, _nothing)
            name = f"agent of {computer.name}"
            executor = own.add((name, 0), 0, agent.made_in(engine, "", devices), ())
            executor.set_wanted(True)
            executor.activate()
            for spec in deployments[computer.name].containers:
                container = engine.container(cpu, computer.name, _nothing, _nothing)
                container.cpu.weight = spec.weight or _WEIGHT
                connectors = {
                    connector.key: work.traffic.connector_in(
                        engine, connector, kinds.get(connector.name, "local")
                    )
                    for connector in spec.connectors
                }
                container.connect(list(connectors.values()))
                for component in spec.components:
                    model = work.models.get(component.name, _USUAL)
                    executor = container.add(
                        component.key,
                        0,
                        model.made_in(engine, component.name, devices),
                        [(c.name, c.is_first, c.deadline) for c in component.chains],
                    )
                    executor.set_wanted(True)
                    executor.set_leased(False)
                    self._executors[component.name] = executor
                inside = {component.name for component in spec.components}
                for connector in spec.connectors:
                    if connector.source in inside:
                        container.add_sender(connectors[connector.key])


def _agent(cores: float) -> ComponentModel:
    sampling = HandlerModel(work=cores * _SAMPLES_EVERY)
    timer = TimerModel(timer=Timer("sample", _SAMPLES_EVERY), handler=sampling)
    return ComponentModel(timers=(timer,) if cores else ())


def _nothing() -> None:
    """Take no notice."""


_ROBOTS = 8
_SHORTEST, _LONGEST = 5.0, 60.0
_PERIODS = 50.0
"""Each robot is simulated for 50 of the longest period, within these times [s]."""
_MOST_EVENTS, _FEWEST_PERIODS = 4e5, 2.0
"""What does more than that meanwhile is simulated for less, but for two periods."""
_OFTEN = 0.01


class PredictedHop(Struct, frozen=True, kw_only=True):
    """How old the data of a chain is when a component uses it.

    Parameters
    ----------
    median, p99
        Its age [s].
    """

    component: str
    computer: str
    median: float
    p99: float


class PredictedChain(Struct, frozen=True, kw_only=True):
    """How old the data of a chain is predicted to be at its last component.

    Parameters
    ----------
    deadline
        How old it may be [s].
    median, p99
        Its age [s]; where no data got to the end while the robot was simulated, the
        length of that.
    late
        The share of uses at which it is older than that.
    slowest
        The component before which data gets oldest.
    hops
        The components after the first one.
    """

    name: str
    deadline: float
    median: float
    p99: float
    late: float
    slowest: str
    hops: tuple[PredictedHop, ...]

    @property
    def margin(self) -> float:
        """How much older it may get than the 99th percentile [s]; below 0: it is."""
        return self.deadline - self.p99


class PredictedTimer(Struct, frozen=True, kw_only=True):
    """How a timer with a deadline is predicted to keep it.

    Parameters
    ----------
    p99
        Of the time from its release to the end of its run [s]; at least the deadline
        where more than one release of a hundred misses it.
    late
        The share of releases that miss the deadline, or are skipped.
    """

    component: str
    timer: str
    deadline: float
    p99: float
    late: float

    @property
    def name(self) -> str:
        """The component and the timer."""
        return f"{self.component}.{self.timer}"


class PredictedTimes(Struct, frozen=True, kw_only=True):
    """What is predicted of a placement.

    Parameters
    ----------
    unknown
        The chains whose data does not get to their end wherever their components run,
        by what is known.
    guesses
        What was assumed, because neither profile nor robot file nor code says it.
    """

    chains: tuple[PredictedChain, ...] = ()
    timers: tuple[PredictedTimer, ...] = ()
    unknown: tuple[str, ...] = ()
    guesses: tuple[str, ...] = ()


def predict_times(
    robot: Robot, placement: Mapping[str, str], work: SimulatedWork
) -> PredictedTimes:
    """Return what is predicted of a placement."""
    models = [work.models[name] for name in placement if name in work.models]
    period = max((t.timer.period for m in models for t in m.timers), default=0.0)
    chains = [c for c in robot.chains if placement.keys() >= {*c.through}]
    seconds = min(_LONGEST, max(_SHORTEST, _PERIODS * period))
    if work.rate:
        least = min(seconds, _FEWEST_PERIODS * period)
        seconds = max(least, min(seconds, _MOST_EVENTS / work.rate))
    robots = [PlacedComponents(robot, placement, work, seed) for seed in range(_ROBOTS)]
    for simulated in robots:
        simulated.run(simulated.now + seconds)
    predictions = {chain: _chain(chain, robots, placement) for chain in chains}
    if None in predictions.values():
        free = PlacedComponents(_uncrowded(robot, len(placement)), placement, work)
        free.run(free.now + seconds)
        for unplaced in [chain for chain, known in predictions.items() if not known]:
            stuck = _chain(unplaced, [free], placement)
            if stuck is not None:  # with CPU enough, its data gets to its end
                predictions[unplaced] = structs.replace(
                    stuck, median=seconds, p99=seconds, late=1.0
                )
    return PredictedTimes(
        chains=tuple(p for p in predictions.values() if p is not None),
        unknown=tuple(c.name for c, known in predictions.items() if known is None),
        timers=tuple(_timers(robots, placement)),
        guesses=work.guesses,
    )


def predict_uncrowded(
    robot: Robot, placement: Mapping[str, str], work: SimulatedWork
) -> PredictedTimes:
    """Return what is predicted of a placement if nobody waited for CPU."""
    return predict_times(_uncrowded(robot, len(placement)), placement, work)


def _uncrowded(robot: Robot, cores: int) -> Robot:
    """Return the robot with a core of the reference for each component."""
    return structs.replace(
        robot,
        computers=tuple(
            structs.replace(
                c, capacity={"cpu": float(cores)}, speed=1.0, address="free"
            )
            for c in robot.computers
        ),
    )


def _chain(
    chain: Chain, robots: list[PlacedComponents], placement: Mapping[str, str]
) -> PredictedChain | None:
    """Return what is predicted of a chain; None: its data never gets to its end."""
    hops, uses, missed = [], 0, 0
    for component in chain.through[1:]:
        statuses = [
            status
            for robot in robots
            for status in robot.chains(component)
            if status.name == chain.name
        ]
        age = mean_of(status.age for status in statuses)
        uses, missed = age.count, sum(status.missed for status in statuses)
        hops.append(
            PredictedHop(
                component=component,
                computer=placement[component],
                median=age.median,
                p99=age.p99,
            )
        )
    if not uses:
        return None
    ages = [0.0, *(hop.median for hop in hops)]
    steps = [after - before for before, after in pairwise(ages)]
    return PredictedChain(
        name=chain.name,
        deadline=chain.deadline,
        median=hops[-1].median,
        p99=hops[-1].p99,
        late=missed / uses,
        slowest=hops[steps.index(max(steps))].component,
        hops=tuple(hops),
    )


def _timers(
    robots: list[PlacedComponents], placement: Mapping[str, str]
) -> Iterator[PredictedTimer]:
    for component in placement:
        for same in zip(*(robot.timers(component) for robot in robots), strict=True):
            first, releases = same[0], sum(timer.releases for timer in same)
            if first.deadline is None or not releases:
                continue
            p99 = sum(
                mean_of(summaries).p99
                for summaries in (
                    [timer.lateness for timer in same],
                    [timer.duration for timer in same],
                )
            )
            late = sum(timer.missed for timer in same) / releases
            yield PredictedTimer(
                component=component,
                timer=first.name,
                deadline=first.deadline,
                p99=max(p99, first.deadline if late > _OFTEN else 0.0),
                late=late,
            )


def mean_of(summaries: Iterable[Summary]) -> Summary:
    """Return what several summaries say, by their numbers of values."""
    known = [summary for summary in summaries if summary.count]
    count = sum(summary.count for summary in known)
    if not count:
        return Summary()
    mean, median, p99 = (
        sum(summary.count * getattr(summary, name) for summary in known) / count
        for name in ("mean", "median", "p99")
    )
    return Summary(count, mean, median, p99, max(summary.maximum for summary in known))
