"""Computes a new placement for a running robot, from its present demands.

CPU may be short: it is shared by priority then (`poise.plan.share_cpu`). The wires that
connectors cross elsewhere change how old data is; what else makes it late stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter

from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.estimate.demands import CPU_HEADROOM
from poise.manage.adaptation.situation import WANTS_MORE, Situation
from poise.manage.migration.migration_report import Proposal
from poise.manage.migration.transition_plan import plan_transition
from poise.manage.observe.chains import ChainAge
from poise.model.robot import Link
from poise.units import format_cores, format_seconds

_TAKES = 0.005
"""Other programs that take less are not worth a word [cores]."""
_LATE = 1.05
"""What is late is older than its deadline by this factor at least, whatever its mean
says."""


def with_time_limits(
    problem: plan.Problem,
    situation: Situation,
    price: float,  # as in `share_what_is_left`
) -> plan.Problem:
    """Return the problem whose limits of chains say what was measured.

    The components of a chain whose data is late compute in vain: F grows by as much as
    if their CPU were short.
    """
    needs = {
        c.name: c.demand.get("cpu", 0.0)
        for c in problem.components
        if c.name in situation.placement
    }
    links = {frozenset(link.between): link for link in problem.links}
    declared = {limit.name: limit for limit in problem.time_limits}
    limits = (
        _measured(declared[chain.chain], chain, links, price, needs)
        for chain in situation.chains
        if chain.chain in declared and chain.computers.keys() <= needs.keys()
    )
    found = tuple(limit for limit in limits if limit is not None)
    return replace(problem, time_limits=found)


def _measured(
    limit: plan.TimeLimit,
    chain: ChainAge,
    links: Mapping[frozenset[str], Link],
    price: float,
    needs: Mapping[str, float],  # component -> its CPU [cores]
) -> plan.TimeLimit | None:
    """Return a chain's limit as it is measured; None: it is late wherever it runs."""
    age, on_wires, hops = chain.ages[chain.last], 0.0, []
    price *= sum(needs[name] for name in chain.computers)
    if chain.is_late:
        age = max(age, _LATE * chain.deadline)
        price *= chain.missed / chain.used / (age / chain.deadline - 1)
    for hop in limit.hops:
        ends, slower = {chain.computers[name] for name in hop.between}, 0.0
        if len(ends) > 1:
            link = links.get(frozenset(ends))
            known = link.latency + hop.size / link.bandwidth if link else 0.0
            slower = max(0.0, chain.wires[hop.between[1]] - known)
            on_wires += known + slower
        hops.append(replace(hop, seconds=slower))
    fixed = max(0.0, age - on_wires)
    if fixed > chain.deadline or price <= 0:
        return None
    return replace(limit, fixed=fixed, hops=tuple(hops), price=price)


STARVED = 0.1
"""A component suffers when it does not do this share of its jobs."""


def nothing_helps(situation: Situation, gone: str = "") -> str:
    """Return that no placement helps what is late, for people."""
    starved = ", ".join(
        f"'{demand.component}' does not do {demand.estimate.starved:.0%} of its work"
        for demand in situation.estimates_at_work()
        if demand.estimate.starved >= STARVED
    )
    too_much = ", ".join(
        f"'{name}' needs {needs}"
        for name, needs in situation.shifted.items()
        if needs.is_bounded and name in situation.placement
    )
    known = too_much or (
        f"{starved}, but by what is known of demands all have the CPU that they need"
        if starved
        else "all components have the CPU that they need where they are"
    )
    takes = taken_by_others(situation)
    others = f", beside other programs, which take {takes}" if takes else ""
    what = f"{late(situation)}{known}{others}: no placement is known to help. "
    if gone:
        return (
            f"{what}Lost with their computers: {gone}; components that need them wait"
        )
    if too_much:
        return f"{what}Give it less to do, or a computer with more CPU"
    return (
        f"{what}Check whether a component is blocked, a link is cut or slow, or a "
        "deadline too short"
    )


def taken_by_others(situation: Situation) -> str:
    """Return what other programs take of the computers, for people; empty: nothing."""
    return ", ".join(
        f"{format_cores(load.background)} of '{name}'"
        for name, load in sorted(situation.loads.items())
        if load.background >= _TAKES
    )


def late(situation: Situation) -> str:
    """Return what each late timer and chain needs and gets, for people."""
    timers = [
        f"timer '{timer.timer}' of component '{timer.component}' must end within "
        f"{format_seconds(timer.deadline)}, and its runs take "
        f"{format_seconds(timer.takes)} (p99)"
        for timer in situation.misses
        if timer.late
    ]
    chains = [_sentence(chain) for chain in situation.chains if chain.is_late]
    return "".join(f"{sentence}; " for sentence in (*timers, *chains))


def _sentence(chain: ChainAge) -> str:
    age, often = chain.ages[chain.last], ""
    if age <= chain.deadline:
        often = f"was older at {chain.missed} of {chain.used} uses, and in the mean "
    under_way = max(0.0, sum(chain.wires.values()))
    arrived = f"; what arrived was under way for {format_seconds(under_way)}"
    return (
        f"the data of chain '{chain.chain}' must not be older than "
        f"{format_seconds(chain.deadline)} and {often}is "
        f"{format_seconds(age)} old ({chain})"
        f"{arrived if under_way else ''}"
    )


SOLVE_FOR = 0.1
"""The planner searches for so long [s]; small robots are proven optimal before."""
DECIDE_FOR = 0.015
"""It searches for so long while the robot waits for a decision [s]."""
EXPLAIN_FOR = 1.0
"""Why nothing fits is looked for about as long at most [s]."""
_BACKGROUND, _HEADROOM, _RESERVE = 0.05, 0.02, 0.005
"""What a core of a margin counts for that is used, as a share of one that is short."""


def propose(
    situation: Situation,
    move: float = 0.0,  # what F grows by for a move, and for each MB of its state
    *,
    costs: Mapping[str, float] | None = None,  # component -> the same, instead
    price: float | None = None,  # as in `share_what_is_left`
    fewer: bool = False,  # whether some are suspended until no CPU is short
    is_quick: bool = False,  # why nothing fits is not looked for
) -> Proposal:
    """Return a better placement for a running robot, and the way to it.

    Raises RobotError: what runs fits nowhere with these demands, or no way leads there.
    """
    now, robot = situation.placement, situation.robot_now
    present = problem_now(situation, move, costs=costs)
    left = replace(present, computers=situation.computers_left())
    problem = with_time_limits(present, situation, price or plan.PRICE)
    if not fewer:
        problem = share_what_is_left(problem, situation, price)
    planner = plan.Planner(problem)
    budget = DECIDE_FOR if is_quick else SOLVE_FOR
    result = planner.decide(budget=budget, steps=situation.solve_steps, fewer=fewer)
    if not result.feasible or result.objective is None:
        if not is_quick:
            explain(result)
        shifted = situation.shifted.items()
        needs = "".join(f"; {name} needs {demand}" for name, demand in shifted)
        raise RobotError(
            f"robot '{robot.name}' has no placement any more: {result.reason}{needs}"
        )
    return Proposal(
        shifted=situation.shifted,
        now=terms_of(problem, now),
        then=result.objective,
        placement=result.placement,
        trouble=plan.evaluate(left, now).reason,
        steps=plan_transition(robot, now, result.placement, shares_cpu=True),
        proven=result.proven,
        suspended=result.suspended,
    )


def problem_now(
    situation: Situation,
    move: float = 0.0,
    *,
    costs: Mapping[str, float] | None = None,
) -> plan.Problem:
    """Return the problem of placing what runs, by its demands; `costs`: of moves."""
    robot, now = situation.robot_now, situation.placement
    functions = situation.functions()
    problem = plan.problem_of(robot, functions=functions, present=now, move=move)
    if costs is not None:
        problem = with_costs(problem, costs)
    # Of alternative architectures only one runs: keep to it.
    return plan.keep_components(problem, now.keys())


def terms_of(problem: plan.Problem, placement: Mapping[str, str]) -> plan.Terms:
    """Return what makes up F of a placement."""
    terms = plan.evaluate(problem, placement).objective
    assert terms is not None  # noqa: S101, a given placement has terms
    return terms


def explain(result: plan.Result) -> None:
    """Look for why nothing fits, for `EXPLAIN_FOR` at most: `reason` says it then."""
    give_up_at = perf_counter() + EXPLAIN_FOR
    result.find_conflict(lambda: perf_counter() > give_up_at)


def share_what_is_left(
    problem: plan.Problem, situation: Situation, price: float | None
) -> plan.Problem:
    """Return the problem with the CPU that other programs leave, shared by priority.

    `price`: what F grows by for each core that is short, of the lowest priority, where
    other terms come to 1; None: far more than by all other terms.
    """
    if price is not None:
        bad = [k for k in problem.links if "-".join(k.between) in situation.bad_links]
        problem = plan.with_small_terms(problem, without=bad)
    late = {timer.computer for timer in situation.misses if timer.late}
    grown = 1 + CPU_HEADROOM  # demands have it already
    usable, limits = dict[str, float](), dict[str, float]()  # computer -> [cores]
    beside_others, beside_growth = dict[str, float](), dict[str, float]()
    for computer in problem.computers:
        name, total = computer.name, computer.total("cpu")
        load = situation.loads.get(name)
        gets = load.background if load else 0.0
        # on a full computer other programs get less than they want
        wants = gets * (WANTS_MORE if load and load.is_full else 1.0)
        left = max(0.0, total - gets)
        usable[name] = left * (1 - computer.reserve.get("cpu", 0.0))
        limits[name] = usable[name] if name in late else left * grown
        beside_growth[name] = max(0.0, total - wants)
        beside_others[name] = beside_growth[name] * grown
    margins = (
        plan.Margin(beside_others, _BACKGROUND),
        plan.Margin(beside_growth, _HEADROOM),
        plan.Margin(usable, _RESERVE),
    )
    return plan.share_cpu(problem, price, limits, margins)


def with_costs(problem: plan.Problem, costs: Mapping[str, float]) -> plan.Problem:
    """Return the problem with what F grows by when a component moves."""
    return replace(
        problem,
        components=tuple(
            replace(c, move_cost=costs.get(c.name, 0.0)) for c in problem.components
        ),
    )
