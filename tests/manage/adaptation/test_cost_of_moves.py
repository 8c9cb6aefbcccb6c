"""Whatever other programs do, moves cost no more than the losses that led to them.

The loop is the real one; the robot, its measurements and time are simulated. Loads are
periodic, random, or follow the components to wherever they went.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from typing import cast

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import Struct

from poise.estimate.online import Estimate
from poise.manage.adaptation import placement_responders
from poise.manage.adaptation.decision import DOWNTIME, START
from poise.manage.adaptation.loop import Adaptation
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import TransitionReport, TransitionStep
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.manage.shortages.suspension import Suspensions
from poise.model.policy import TimerValues
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Robot,
    Task,
)

LOOK = 0.5
"""The loop looks at the robot this often [s]; a real one does so more often."""
MOVE = 0.3
"""A move takes this long [s]."""
CALM = 300.0
"""The load stays the same for this long in the end [s]."""
QUIET = 100.0
"""In the last part of that hardly anything moves any more [s]."""
NUM_COMPUTERS = 3


class Moved(Struct, frozen=True):
    """A move of the simulated robot; `at` [s]."""

    at: float
    component: str
    source: str
    target: str


Background = Callable[["World"], dict[str, float]]
"""Computer -> the CPU that other programs want there [cores]."""


class World:
    """Computers of one core with eight components, and other programs on them."""

    def __init__(self, seed: int, background: Background) -> None:
        self.now = 1000.0
        self.random = random.Random(seed)
        components = tuple(
            ComponentEntry(name=f"c{i}", demand={"cpu": self.random.uniform(0.05, 0.3)})
            for i in range(8)
        )
        self.names = [f"h{i}" for i in range(NUM_COMPUTERS)]
        self.robot = Robot(
            name="simulated",
            computers=tuple(
                Computer(name=n, capacity={"cpu": 1.0}) for n in self.names
            ),
            architectures=(
                Architecture(name="all", function="all", components=components),
            ),
            tasks=(Task(name="t", actions=(Action(name="a", functions=("all",)),)),),
        )
        self.placement = {
            c.name: self.names[i % NUM_COMPUTERS] for i, c in enumerate(components)
        }
        self.background = background
        self.moves: list[Moved] = []
        self.lost = 0.0
        self._lately: deque[tuple[dict[str, float], dict[str, float]]] = deque(maxlen=2)

    def step(self) -> None:
        """Let some time pass, and measure."""
        self.now += LOOK
        wanted = self.background(self)
        for name, needed in self.needs().items():
            self.lost += LOOK * max(0.0, needed + wanted[name] - 1.0)
        self._lately.append((self.needs(), self.background(self)))

    def needs(self) -> dict[str, float]:
        """Return what the components of each computer need now [cores]."""
        needs = dict.fromkeys(self.names, 0.0)
        for component in self.robot.components():
            needs[self.placement[component.name]] += component.demand["cpu"]
        return needs

    def situation(self) -> Situation:
        """Return what a manager would know: loads over a second, and who is late."""
        loads, late = {}, set()
        for name in self.names:
            needed = sum(needs[name] for needs, _ in self._lately) / len(self._lately)
            wanted = sum(other[name] for _, other in self._lately) / len(self._lately)
            # components and other programs share a full computer in halves at least
            got = min(wanted, max(1.0 - needed, 0.5))
            loads[name] = Load(
                capacity=1.0, used=min(1.0, needed + got), background=got
            )
            if needed + got > 1.0 + 1e-9:
                late.add(name)
        return Situation(
            robot=self.robot,
            placement=dict(self.placement),
            loads=loads,
            misses=tuple(
                TimerValues(
                    name=f"{component}.tick",
                    component=component,
                    computer=computer,
                    timer="tick",
                    released=10,
                    missed=5,
                    deadline=0.1,
                    late=True,
                )
                for component, computer in self.placement.items()
                if computer in late
            ),
            demand_estimates=tuple(self._estimates()),
        )

    def _estimates(self) -> list[DemandEstimate]:
        found = []
        for component in self.robot.components():
            mean = component.demand["cpu"] * self.random.uniform(0.95, 1.05)
            estimate = Estimate(mean=mean, p95=mean, error=0.1 * mean)
            found.append(
                DemandEstimate(
                    component=component.name,
                    computer=self.placement[component.name],
                    expected=None,
                    estimate=estimate,
                )
            )
        return found

    def transit(
        self, _: LiveRobot, steps: tuple[TransitionStep, ...], **__: object
    ) -> TransitionReport:
        """Make the moves at once; each takes some time."""
        before = dict(self.placement)
        for step in steps:  # a cold move is a stop and a start
            self.now += MOVE
            if step.target:
                self.placement[step.component] = step.target
        self.moves += [
            Moved(self.now, component, source, self.placement[component])
            for component, source in before.items()
            if source != self.placement[component]
        ]
        return TransitionReport(steps=steps, committed=True)


class Nothing:
    """Takes all calls, and does nothing: a journal, and what suspends."""

    def due(self, _: float) -> tuple[Architecture, ...]:
        return ()

    def __getattr__(self, _: str) -> Callable[..., None]:
        return lambda *_, **__: None


class Robotless:
    """What the loop asks of a run."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.journal = Nothing()
        self.desired = Desired()
        self.parts = Unsupervised()


class Unsupervised:
    """Parts of the loop, of which an error fails the test."""

    def run(self, _: str, work: Callable[[], object], **__: object) -> object:
        return work()


def run(world: World, seconds: float) -> World:
    """Let the loop look after a world for some time, then keep its load as it is."""
    patch = pytest.MonkeyPatch()
    patch.setattr(placement_responders, "transit", world.transit)
    try:
        adaptation = Adaptation(
            cast("LiveRobot", Robotless(world.robot)),
            world.situation,
            cast("Suspensions", Nothing()),
            clock=lambda: world.now,
        )
        end = world.now + seconds
        while world.now < end:
            world.step()
            adaptation.adapt()
        kept = world.background(world)
        world.background = lambda _: kept
        end = world.now + CALM
        while world.now < end:
            world.step()
            adaptation.adapt()
    finally:
        patch.undo()
    return world


def periodic(seed: int) -> Background:
    """Return loads that come and go, each computer's with a period of its own."""
    chance = random.Random(seed)
    waves = [
        (chance.uniform(1, 120), chance.random(), chance.uniform(0.2, 1.0))
        for _ in range(NUM_COMPUTERS)
    ]

    def background(world: World) -> dict[str, float]:
        return {
            name: wanted if (world.now / period + phase) % 1 < 0.5 else 0.0
            for name, (period, phase, wanted) in zip(world.names, waves, strict=True)
        }

    return background


def randomly(seed: int) -> Background:
    """Return loads that jump at random moments."""
    chance = random.Random(seed)
    loads: dict[str, float] = {}

    def background(world: World) -> dict[str, float]:
        for name in world.names:
            if name not in loads or chance.random() < LOOK / 20:
                loads[name] = max(0.0, chance.uniform(-0.5, 1.0))
        return dict(loads)

    return background


def adversarial(_: int) -> Background:
    """Return a load that is always where most components are."""

    def background(world: World) -> dict[str, float]:
        needs = world.needs()
        busiest = max(needs, key=lambda name: needs[name])
        return {name: 0.9 if name == busiest else 0.0 for name in world.names}

    return background


KINDS = {"periodic": periodic, "random": randomly, "adversarial": adversarial}


def check(world: World) -> None:
    """Hold that moves cost no more than what was lost, and that it came to rest."""
    cost = len(world.moves) * (START + 0.3 * DOWNTIME)
    assert cost <= world.lost, (cost, world.lost)
    last = {m.at for m in world.moves if m.at > world.now - QUIET}
    assert len(last) <= 2, last  # what is in vain is tried again, later each time


@pytest.mark.slow  # it takes half a second
@pytest.mark.parametrize("kind", KINDS)
def test_moves_cost_no_more_than_a_load_takes(kind: str) -> None:
    world = run(World(1, KINDS[kind](1)), 60.0)
    assert world.moves
    check(world)


def every_load(examples: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Test with this many loads."""
    strategies = given(seed=st.integers(0, 2**32), kind=st.sampled_from(sorted(KINDS)))
    limits = settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    return lambda test: limits(strategies(test))


@pytest.mark.exhaustive
@pytest.mark.slow
@every_load(12)
def test_moves_cost_no_more_than_any_load_takes(seed: int, kind: str) -> None:
    check(run(World(seed, KINDS[kind](seed)), 300.0))


@pytest.mark.slow
@pytest.mark.exhaustive
@every_load(120)
def test_they_do_under_none_of_many_loads(seed: int, kind: str) -> None:
    check(run(World(seed, KINDS[kind](seed)), 300.0))
