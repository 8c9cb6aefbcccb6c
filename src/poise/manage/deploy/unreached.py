"""What is known of computers that are out of reach, in words."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import inf

from poise.clock import time_of_day, wall_time
from poise.manage.agent_connections.agents import Agents

_REPORTS_WITHIN = 1.0
"""Agents that are reached report more often [s]."""


def unreached(
    agents: Agents, placement: Mapping[str, str], leased: Collection[str]
) -> dict[str, str]:
    """Return what is known of each computer that is out of reach, in words."""
    ages, now = agents.ages(), wall_time()
    sentences = {}
    for computer, since in sorted(agents.out_of_reach().items()):
        known = [
            f"computer '{computer}' has been out of reach since {time_of_day(since)}"
        ]
        is_reporting = ages.get(computer, inf) < _REPORTS_WITHIN
        if is_reporting and now - since > 2 * _REPORTS_WITHIN:
            known.append("its reports (TCP) come, but no heartbeats (UDP)")
        inside = sorted(name for name, at in placement.items() if at == computer)
        known += _what_becomes(agents, computer, inside, leased)
        known.append(agents.other_agent(computer))
        sentences[computer] = "; ".join(filter(None, known))
    return sentences


def _what_becomes(
    agents: Agents, computer: str, inside: Sequence[str], leased: Collection[str]
) -> Iterator[str]:
    """Yield how a computer is still heard, and what becomes of its components."""
    how = ""
    if agents.heartbeats.is_heard(computer):
        how = "it still sends heartbeats (UDP), but accepts no connection (TCP)"
    elif other := agents.heartbeats.heard_by(computer):
        how = f"'{other}' still reaches it"
    if how:
        yield f"{how}: {_clause(inside, 'keep')} running" if inside else how
        return
    if stop := [name for name in inside if name in leased]:
        yield f"{_clause(stop, 'stop')} there when its lease ends"
    if stay := [name for name in inside if name not in leased]:
        yield f"{', '.join(stay)} may still be at work there"


def _clause(names: Sequence[str], verb: str) -> str:
    return f"{', '.join(names)} {verb if len(names) > 1 else verb + 's'}"
