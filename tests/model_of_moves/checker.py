"""Explores every state of a model, and tells the shortest way to a bad one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from typing import Generic, NamedTuple, TypeVar

S = TypeVar("S", bound=Hashable)

Successors = Callable[[S], Iterator[tuple[str, S]]]
"""Yields what may happen next: the name of the step, and the state after it."""


class Report(NamedTuple, Generic[S]):
    """What was found; `trouble` is empty when all is well.

    `way` names the steps from the initial state to the troubled one.
    """

    num_states: int
    trouble: str
    way: tuple[str, ...]


def explore(
    initial: S,
    successors: Successors[S],
    trouble_of: Callable[[S], str],
    is_final: Callable[[S], bool],
) -> Report[S]:
    """Look at every reachable state, nearest first.

    Parameters
    ----------
    trouble_of
        Returns what is wrong with a state; empty when nothing is.
    is_final
        Whether a state is an end: all is done, and nothing need happen any more.

    Returns
    -------
    A state with trouble; else one that is stuck before the end; else one from which no
    end can be reached; else none.
    """
    # a state is hashed once for each way to it, which is what all of this takes longest
    numbers, states = {initial: 0}, [initial]
    came_from: list[tuple[int, str]] = [(0, "")]
    before: list[list[int]] = [[]]
    ends: list[int] = []
    for number, state in enumerate(states):  # which grow
        trouble = trouble_of(state)
        followers = () if trouble else tuple(successors(state))
        if is_final(state):
            ends.append(number)
        elif not trouble and not followers:
            trouble = f"stuck: {state}"
        if trouble:
            return Report(len(states), trouble, _way(came_from, number))
        for name, follower in followers:
            then = numbers.setdefault(follower, len(states))
            if then == len(states):
                states.append(follower)
                came_from.append((number, name))
                before.append([])
            before[then].append(number)
    lost = _first_without_end(before, ends)
    if lost is not None:
        return Report(len(states), f"no end: {states[lost]}", _way(came_from, lost))
    return Report(len(states), "", ())


def _first_without_end(before: list[list[int]], ends: list[int]) -> int | None:
    good, waiting = set(ends), list(ends)
    while waiting:
        for number in before[waiting.pop()]:
            if number not in good:
                good.add(number)
                waiting.append(number)
    return next((number for number in range(len(before)) if number not in good), None)


def _way(came_from: list[tuple[int, str]], number: int) -> tuple[str, ...]:
    names: list[str] = []
    while number:
        number, name = came_from[number]
        names.append(name)
    return tuple(reversed(names))
