"""Places components one by one, as schedulers of clusters and of other middleware do.

Both are models of published rules, not the programs. Pure.

It imports internal modules: it places robots of the experiment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import fmean, pstdev

from msgspec import Struct

import poise
from poise.model.robot import Robot
from poise.plan import Item, Problem

Free = dict[str, dict[str, float]]
"""Computer -> resource -> how much of it nothing has asked for yet."""


class Choice(Struct, frozen=True):
    """What a rule sees: the component, where it may run, and what is free."""

    item: Item
    computers: Sequence[str]
    free: Free
    whole: Mapping[str, Mapping[str, float]]

    def share_free(self, computer: str, resource: str) -> float:
        """Return the share of a resource that is free once the component is there."""
        wanted = self.item.demand.get(resource, 0.0)
        left = self.free[computer][resource] - wanted
        return left / self.whole[computer][resource]


def least_allocated(choice: Choice) -> str:
    """Choose as Kubernetes' scheduler does by default.

    Of the nodes that the requests fit on, the one with the best sum of the scores
    NodeResourcesFit (LeastAllocated) and NodeResourcesBalancedAllocation, over CPU and
    memory; the one with most CPU left where none fits, since a pod that stays pending
    would be a function that nobody tried.
    """

    def score(computer: str) -> float:
        shares = [choice.share_free(computer, name) for name in ("cpu", "memory")]
        return fmean(shares) + 1 - pstdev(shares)

    fits = [
        name
        for name in choice.computers
        if min(choice.share_free(name, resource) for resource in ("cpu", "memory")) >= 0
    ]
    return max(fits, key=score) if fits else least_loaded(choice)


def least_loaded(choice: Choice) -> str:
    """Choose as YARP's manager balances: the host with the least load now."""
    return max(choice.computers, key=lambda name: choice.free[name]["cpu"])


BALANCERS: Mapping[str, Callable[[Choice], str]] = {
    "least-allocated": least_allocated,
    "least-loaded": least_loaded,
}


def balanced(robot: Robot, task: str, rule: str) -> dict[str, str]:
    """Return component -> computer for the architectures that run without Poise."""
    home = poise.place(robot, task, method="static")
    problem: Problem = home.result.problem
    whole = {
        each.name: {
            resource: amount
            * (each.speed if resource == "cpu" else 1.0)
            * (1 - each.reserve.get(resource, 0.0))
            for resource, amount in each.capacity.items()
        }
        for each in problem.computers
    }
    free = {name: dict(resources) for name, resources in whole.items()}
    items = {each.name: each for each in problem.components}
    where = {}
    for name in home.where:
        item = items[name]
        choice = Choice(item, item.only or tuple(whole), free, whole)
        where[name] = computer = BALANCERS[rule](choice)
        for resource in ("cpu", "memory"):
            free[computer][resource] -= item.demand.get(resource, 0.0)
    return where
