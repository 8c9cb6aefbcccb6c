"""A robot of two computers, and what the loop may know of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from poise.estimate.online import Estimate
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.model.policy import TimerValues
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Robot,
    Task,
)

Make = Callable[..., Situation]


@pytest.fixture
def two() -> Robot:
    """Return computers of half a core, and components of 0.2 and 0.2."""
    return Robot(
        name="two",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 0.5}) for name in ("left", "right")
        ),
        architectures=(
            Architecture(
                name="all",
                function="all",
                components=tuple(
                    ComponentEntry(name=name, demand={"cpu": 0.2})
                    for name in ("a", "b")
                ),
            ),
        ),
        tasks=(Task(name="work", actions=(Action(name="w", functions=("all",)),)),),
    )


@pytest.fixture
def situation(two: Robot) -> Make:
    """Return what makes situation; both components are on `left` unless said."""

    def make(
        placement: Mapping[str, str] | None = None,
        *,
        background: Mapping[str, float] | None = None,
        missed: tuple[str, ...] = (),
        robot: Robot = two,
    ) -> Situation:
        placement = placement or {"a": "left", "b": "left"}
        background = background or {}
        loads = {
            computer.name: Load(
                capacity=0.5,
                used=min(0.5, 0.2 * n + background.get(computer.name, 0.0)),
                background=background.get(computer.name, 0.0),
            )
            for computer in robot.computers
            for n in [list(placement.values()).count(computer.name)]
        }
        return Situation(
            robot=robot,
            placement=placement,
            loads=loads,
            misses=tuple(
                TimerValues(
                    name=f"{name}.tick",
                    component=name,
                    computer=placement[name],
                    timer="tick",
                    released=10,
                    missed=5,
                    deadline=0.1,
                    takes=0.03,
                    over=1.0,
                    late=True,
                )
                for name in missed
            ),
            demand_estimates=tuple(
                DemandEstimate(
                    component=name,
                    computer=at,
                    expected=None,
                    estimate=Estimate(mean=0.2, p95=0.2, error=0.01),
                )
                for name, at in placement.items()
            ),
        )

    return make
