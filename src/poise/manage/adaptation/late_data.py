"""Whose data is late, and how old it would be elsewhere. Pure.

A chain's data is as old as was measured. Elsewhere it would be younger, or older, by
the wires that connectors cross there. What is late for other reasons stays late.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from poise import plan
from poise.manage.adaptation.situation import Situation
from poise.manage.observe.chains import ChainAge
from poise.model.robot import Link
from poise.units import format_cores, format_seconds

_TAKES = 0.005
"""Other programs that take less are not worth a word [cores]."""
_LATE = 1.05
"""What is late is older than its deadline by this factor at least, whatever its mean
says."""


def with_time_limits(
    problem: plan.Problem, situation: Situation, price: float
) -> plan.Problem:
    """Return the problem whose limits of chains say what was measured.

    The components of a chain whose data is late compute in vain: F grows by as much as
    if their CPU were short.

    Parameters
    ----------
    price
        What F grows by for each core that is short, of the lowest priority.
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
    needs: Mapping[str, float],
) -> plan.TimeLimit | None:
    """Return a chain's limit as it is measured; None: it is late wherever it runs.

    Parameters
    ----------
    needs
        Component -> its CPU [cores].
    """
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


def nothing_helps(situation: Situation) -> str:
    """Return that no placement helps what is late, for people."""
    return (
        f"{late(situation)}by their demands all components fit where they are"
        f"{_others(situation)}: another placement would not help. "
        "Is a component blocked, or its deadline too short for its work?"
    )


def _others(situation: Situation) -> str:
    """Return what other programs take of the computers, for people."""
    takes = [
        f"{format_cores(load.background)} of '{name}'"
        for name, load in sorted(situation.loads.items())
        if load.background >= _TAKES
    ]
    return f", beside other programs, which take {', '.join(takes)}" if takes else ""


def late(situation: Situation) -> str:
    """Return what each late timer and chain needs and gets, for people."""
    timers = [
        f"timer '{each.timer}' of component '{each.component}' must end within "
        f"{format_seconds(each.deadline)}, and its runs take "
        f"{format_seconds(each.takes)} (p99)"
        for each in situation.misses
        if each.late
    ]
    chains = [_sentence(each) for each in situation.chains if each.is_late]
    return "".join(f"{sentence}; " for sentence in (*timers, *chains))


def _sentence(chain: ChainAge) -> str:
    age = chain.ages[chain.last]
    best = age - sum(chain.wires.values())
    return (
        f"the data of chain '{chain.chain}' must not be older than "
        f"{format_seconds(chain.deadline)} and is {format_seconds(age)} old, "
        f"{format_seconds(max(0.0, best))} if all of the chain were on one computer "
        f"({chain})"
    )
