"""What may be needed next, and where the plan over time puts it."""

from __future__ import annotations

from poise.manage.tasks.action_placement import PlanOverTime, likely_next
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.model.steps import Action, Task


def test_the_components_of_the_next_action_are_likely_where_they_are_planned() -> None:
    robot = Robot(
        name="r",
        computers=(
            Computer(name="left", capacity={"cpu": 0.5, "memory": 1e9}),
            Computer(name="right", capacity={"cpu": 0.5, "memory": 1e9}),
        ),
        architectures=tuple(
            Architecture(
                name=f"{name}-arch",
                function=name,
                components=(ComponentEntry(name=name, demand={"cpu": 0.3}, only=only),),
            )
            for name, only in (("see", ("left",)), ("go", ("right",)), ("say", ()))
        ),
        tasks=(
            Task(
                name="t",
                actions=(
                    Action(name="look", functions=("see",)),
                    Action(name="drive", functions=("see", "go")),
                ),
            ),
        ),
    )
    tasks, plans = Tasks(robot), PlanOverTime(robot)
    tasks.start("t", 0.0)
    tasks.arbitrate(0.0)
    ahead = tasks.next_actions()
    (report,) = tasks.reports(ahead, lambda _: (), 0.0)
    assert report.next == ("drive",)
    (found,) = likely_next(ahead, plans, {"see": "left"}, {})
    assert (found.what, found.placement, found.probability) == (
        "action 'drive' of task 't'",
        {"go": "right"},
        1.0,
    )
    assert likely_next(ahead, plans, {"see": "left", "go": "right"}, {}) == []
    assert plans.placement("t", ("look",), ("see",)) == {"see": "left"}
