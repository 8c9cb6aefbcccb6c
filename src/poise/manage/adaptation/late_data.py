"""What is late though all components have the CPU that they need. Pure.

A chain whose data loses its time on a wire is helped by a placement that has the ends
of the slowest step on one computer. Nothing else is helped by any.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet

from msgspec import Struct

from poise.manage.adaptation.situation import Homes, Situation
from poise.manage.observe.chains import ChainAge
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot
from poise.units import format_cores, format_seconds

_TAKES = 0.005
"""Other programs that take less are not worth a word [cores]."""


class Relief(Struct, frozen=True, kw_only=True):
    """What might help a late chain.

    Parameters
    ----------
    why
        What is late, needs what, and gets what at best, for people.
    homes
        Two components -> the computer that they should share; none: nothing helps.
    wasted
        What its components compute in vain now [cores].
    """

    why: str
    homes: Homes = {}
    wasted: float = 0.0


def relieve(
    robot: Robot, situation: Situation, barred: Mapping[str, AbstractSet[str]]
) -> Relief:
    """Return what might help the late chains, or why nothing does.

    Parameters
    ----------
    barred
        Component -> computers where it may not go.
    """
    allowed = allowed_computers(robot)
    movable = {c.name for c in robot.components() if c.movable}
    needs = {each.component: each.estimate.mean for each in situation.demand_estimates}
    for chain in situation.chains:
        before, after = _longest_wire(chain)
        age = chain.ages[chain.last]
        if not chain.is_late or age - chain.wires[after] > chain.deadline:
            continue
        for stays, moves in ((before, after), (after, before)):
            home = chain.computers[stays]
            if (
                moves in movable
                and home in allowed[moves] - barred.get(moves, frozenset())
                and home != chain.computers[moves]
            ):
                return Relief(
                    why=_sentence(chain),
                    homes={stays: (home,), moves: (home,)},
                    wasted=sum(needs.get(name, 0.0) for name in chain.ages)
                    * chain.missed
                    / chain.used,
                )
    return Relief(
        why=f"{late(situation)}by their demands all components fit where they are"
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


def _longest_wire(chain: ChainAge) -> tuple[str, str]:
    return max(
        ((one, next_) for one, next_, _ in chain.steps()),
        key=lambda step: chain.wires[step[1]],
    )


def _sentence(chain: ChainAge) -> str:
    age = chain.ages[chain.last]
    best = age - sum(chain.wires.values())
    return (
        f"the data of chain '{chain.chain}' must not be older than "
        f"{format_seconds(chain.deadline)} and is {format_seconds(age)} old, "
        f"{format_seconds(max(0.0, best))} if all of the chain were on one computer "
        f"({chain})"
    )
