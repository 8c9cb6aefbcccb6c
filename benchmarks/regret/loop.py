"""Poise's loop of adaptation, with a simulated robot, measurements and time.

The loop is the real one, with the policies that Poise ships. What it measures is the
mean of two steps. A full computer gives all that runs there the same share of what that
wants, so what components need is late, and other programs are seen to use less than
they want. Estimates of demands are off by up to 5 %, at random.

It imports internal modules: the loop has no public name.
"""

from __future__ import annotations

import random
import sys
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from functools import cache
from types import ModuleType
from typing import cast
from unittest import mock

import numpy as np
from msgspec import Struct

from benchmarks.regret.costs import Move
from benchmarks.regret.rules import SOLVE_STEPS
from benchmarks.regret.traces import STEP, Cores, Placement, Trace
from poise.estimate.online import LEAST_SHARE, Drift, Estimate
from poise.manage.adaptation.loop import Adaptation
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.desired import Desired, Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration import transition_run
from poise.manage.migration.coordinator import stuck_components
from poise.manage.migration.migration_report import TransitionReport, TransitionStep
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.manage.shortages.suspension import Suspensions
from poise.model.policy import TimerValues
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Device,
    Robot,
    Task,
)

BEGAN = 1000.0
"""The time of the first step [s]."""
NOISE = 0.05
ERROR = 0.1
"""The error that an estimate says of itself, as a share of it."""


class Act(Struct, frozen=True):
    """A transition that the loop made after a step, from a placement."""

    step: int
    placement: Placement
    num_steps: int


class Loop:
    """A rule that asks the real loop.

    Attributes
    ----------
    acts
        The transitions, without restarts of what was on a lost computer.
    """

    def __init__(self, trace: Trace) -> None:
        self.acts: list[Act] = []
        self.robot = _robot(trace)
        self.journal = _Nothing()
        self.parts = _Tick()
        self._trace = trace
        self._random = random.Random(trace.seed)
        self._left = trace.left
        self._computers = [c.name for c in self.robot.computers]
        self._components = [c.name for c in self.robot.components()]
        self._step = 0
        self._placement: Placement = trace.start
        self._moves: list[Move] = []
        self._lately: deque[Cores] = deque(maxlen=2)
        self._adaptation = Adaptation(
            cast("LiveRobot", self),
            self._situation,
            cast("Suspensions", _Nothing()),
            clock=lambda: BEGAN + self._step * STEP,
        )

    def __call__(self, step: int, placement: Placement) -> Sequence[Move]:
        """Return what the loop moves after a step."""
        self._step, self._placement, self._moves = step, placement, []
        needed = np.zeros(len(self._computers))
        np.add.at(needed, list(placement), self._trace.demands[step])
        self._lately.append(needed)
        with ExitStack() as stack:
            for module, name in _transitions():
                patch = mock.patch.object(module, name, getattr(self, name))
                stack.enter_context(patch)
            self._adaptation.adapt()
        return self._moves

    @property
    def desired(self) -> Desired:
        """What should run, as a run of Poise has it."""
        placed = {
            name: Incarnation(component=name, computer=computer)
            for name, computer in self._where().items()
        }
        return Desired(placed=placed)

    def transit(
        self, _: LiveRobot, steps: tuple[TransitionStep, ...]
    ) -> TransitionReport:
        """Make moves; a cold one is a stop and a start."""
        self.acts.append(Act(self._step, self._placement, len(steps)))
        for step in steps:
            if step.target:
                self._move({step.component: step.target})
        return TransitionReport(steps=steps, committed=True)

    def start_together(
        self,
        _: LiveRobot,
        placement: Mapping[str, str],
        lost: Collection[str] = (),  # noqa: ARG002 - as the real one
    ) -> bool:
        """Restart components elsewhere."""
        self._move(placement)
        return True

    def stuck_components(self, _: LiveRobot) -> set[str]:
        """Return none: these components have no connectors."""
        return set()

    def _move(self, placement: Mapping[str, str]) -> None:
        self._moves += [
            (self._components.index(name), self._computers.index(computer))
            for name, computer in placement.items()
        ]

    def _where(self) -> dict[str, str]:
        return {
            name: self._computers[at]
            for name, at in zip(self._components, self._placement, strict=True)
        }

    def _situation(self) -> Situation:
        """Return what a manager would know."""
        now, trace = self._step, self._trace
        since = max(0, now - 1)
        loads, late = {}, set()
        lost = {
            n
            for n, is_lost in zip(self._computers, trace.lost[now], strict=True)
            if is_lost
        }
        needed = np.mean(self._lately, axis=0)
        wanted = trace.background[since : now + 1].mean(axis=0)
        for name, need, want, capacity in zip(
            self._computers, needed, wanted, trace.capacity, strict=True
        ):
            if name in lost:
                continue
            share = min(1.0, capacity / (need + want)) if need + want else 1.0
            loads[name] = Load(
                capacity=float(capacity),
                used=float(share * (need + want)),
                background=float(share * want),
            )
            if share < 1.0 - 1e-9:
                late.add(name)
        return Situation(
            robot=self.robot,
            placement=self._where(),
            lost=frozenset(lost),
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
                for component, computer in self._where().items()
                if computer in late
            ),
            demand_estimates=tuple(
                self._estimate(number, float(demand))
                for number, demand in enumerate(
                    trace.demands[since : now + 1].mean(axis=0)
                )
            ),
            solve_steps=SOLVE_STEPS,
        )

    def _estimate(self, number: int, demand: float) -> DemandEstimate:
        """Return what is known of a demand [cores]."""
        component = [*self.robot.components()][number]
        expected = component.demand["cpu"]
        mean = demand * self._random.uniform(1 - NOISE, 1 + NOISE)
        has_drifted = abs(demand - expected) > LEAST_SHARE * expected
        return DemandEstimate(
            component=component.name,
            computer=self._computers[self._placement[number]],
            expected=expected,
            estimate=Estimate(
                mean=mean,
                p95=mean,
                error=ERROR * mean,
                drift=Drift(BEGAN, expected, mean) if has_drifted else None,
            ),
        )


def _robot(trace: Trace) -> Robot:
    """Return the robot, each component with a function of its own."""
    names = [f"c{i}" for i in range(len(trace.pins))]
    devices = [f"d{i}" if pin is not None else "" for i, pin in enumerate(trace.pins)]
    return Robot(
        name="simulated",
        computers=tuple(
            Computer(name=f"h{i}", capacity={"cpu": 1.0}, speed=float(speed))
            for i, speed in enumerate(trace.capacity)
        ),
        devices=tuple(
            Device(name=f"d{i}", computer=f"h{pin}")
            for i, pin in enumerate(trace.pins)
            if pin is not None
        ),
        architectures=tuple(
            Architecture(
                name=name,
                function=name,
                components=(
                    ComponentEntry(
                        name=name,
                        demand={"cpu": float(demand)},
                        devices=(device,) if device else (),
                    ),
                ),
            )
            for name, demand, device in zip(
                names, trace.demands.mean(axis=0), devices, strict=True
            )
        ),
        tasks=(
            Task(name="all", actions=(Action(name="all", functions=tuple(names)),)),
        ),
    )


@cache
def _transitions() -> Sequence[tuple[ModuleType, str]]:
    """Return where Poise's adaptation asks about a real robot, and moves components."""
    real = (transition_run.transit, transition_run.start_together, stuck_components)
    return [
        (module, name)
        for module in [*sys.modules.values()]
        if module.__name__.startswith(
            ("poise.manage.adaptation.", "poise.manage.shortages.")
        )
        for function in real
        if vars(module).get(name := function.__name__) is function
    ]


class _Nothing:
    """Takes all calls, and does nothing: a journal, and what suspends."""

    def suspend(self, *_: object) -> bool:
        """Say that it went well: this robot's architectures never stop."""
        return True

    def due(self, _: float) -> Sequence[Architecture]:
        """Return nothing: nothing is suspended."""
        return ()

    def __getattr__(self, _: str) -> Callable[..., None]:
        return lambda *_, **__: None


class _Tick:
    """A tick in which an error of a responder ends the benchmark."""

    def run(self, _: str, work: Callable[[], object], **__: object) -> object:
        return work()
