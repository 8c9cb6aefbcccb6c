"""What `poise.plan` gives to others."""

from poise.plan.explanation import Explanation, Option, Rejection, explain
from poise.plan.fewest_computers import Smallest, smallest
from poise.plan.from_robot import problem_of, static
from poise.plan.phase_problem import PhaseProblem, TaskProblem, task_problem_of
from poise.plan.phase_result import PhaseMove, TaskResult
from poise.plan.phase_search import solve_phases
from poise.plan.planner import Overload, Planner, evaluate, solve
from poise.plan.problem.changed_problem import (
    PRICE,
    Margin,
    add,
    keep_components,
    scale,
    share_cpu,
    with_small_terms,
    without,
)
from poise.plan.problem.items import Bundle, Edge, Hop, Item, Run, SoftLimit, TimeLimit
from poise.plan.problem.problem import Problem, load, schema
from poise.plan.result import Result
from poise.plan.result_records import (
    ComputerTried,
    Conflict,
    GreedyStep,
    More,
    Shortage,
    Terms,
    Tightest,
    TimeTaken,
)

__all__ = [
    "PRICE",
    "Bundle",
    "ComputerTried",
    "Conflict",
    "Edge",
    "Explanation",
    "GreedyStep",
    "Hop",
    "Item",
    "Margin",
    "More",
    "Option",
    "Overload",
    "PhaseMove",
    "PhaseProblem",
    "Planner",
    "Problem",
    "Rejection",
    "Result",
    "Run",
    "Shortage",
    "Smallest",
    "SoftLimit",
    "TaskProblem",
    "TaskResult",
    "Terms",
    "Tightest",
    "TimeLimit",
    "TimeTaken",
    "add",
    "evaluate",
    "explain",
    "keep_components",
    "load",
    "problem_of",
    "scale",
    "schema",
    "share_cpu",
    "smallest",
    "solve",
    "solve_phases",
    "static",
    "task_problem_of",
    "with_small_terms",
    "without",
]
