"""Where each component runs: the objective, the greedy, search, proof, explanation."""

from poise.plan.change import add, keep_components, scale, without
from poise.plan.describe import evaluate
from poise.plan.explain import Explanation, Option, explain
from poise.plan.load import load
from poise.plan.problem import (
    Architecture,
    Component,
    Computer,
    Connector,
    Link,
    Problem,
)
from poise.plan.result import Conflict, More, Result, Step, Terms, Tightest, Trial
from poise.plan.robot import problem_of, static
from poise.plan.schema import schema
from poise.plan.smallest import Smallest, smallest
from poise.plan.solve import solve, trace

__all__ = [
    "Architecture",
    "Component",
    "Computer",
    "Conflict",
    "Connector",
    "Explanation",
    "Link",
    "More",
    "Option",
    "Problem",
    "Result",
    "Smallest",
    "Step",
    "Terms",
    "Tightest",
    "Trial",
    "add",
    "evaluate",
    "explain",
    "keep_components",
    "load",
    "problem_of",
    "scale",
    "schema",
    "smallest",
    "solve",
    "static",
    "trace",
    "without",
]
