"""Explores every state of a model, and tells the shortest way to a bad one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Generic, NamedTuple, TypeVar

S = TypeVar("S", bound=Hashable)

Successors = Callable[[S], Iterator[tuple[str, S]]]
"""Yields what may happen next: the name of the step, and the state after it."""
IsEager = Callable[[S, str], bool]
"""Whether a step of this name may be taken at once in this state, and no other."""


def no_step_is_eager(_: object, __: str) -> bool:
    """Let nothing be left out."""
    return False


class Report(NamedTuple, Generic[S]):
    """What was found; `trouble` is empty when all is well.

    `way` names the steps from the initial state to the troubled one. `last` are the
    states after which nothing can happen, when there was no trouble.
    """

    num_states: int
    trouble: str
    way: tuple[str, ...]
    last: frozenset[S] = frozenset()


def explore(
    initial: S,
    successors: Successors[S],
    trouble_of: Callable[[S], str],
    is_final: Callable[[S], bool],
    is_eager: IsEager[S] = no_step_is_eager,
) -> Report[S]:
    """Look at every reachable state, nearest first, but for what eager steps skip.

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
    last: list[S] = []
    for number, state in enumerate(states):  # which grow
        trouble = trouble_of(state)
        followers = () if trouble else _chosen(state, successors, is_eager)
        if not followers:
            last.append(state)
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
    return Report(len(states), "", (), frozenset(last))


def crossings(
    initial: S,
    successors: Successors[S],
    is_eager: IsEager[S],
    visible: Callable[[S], object],
) -> Iterator[str]:
    """Look at all states, and yield what breaks the rule of eager steps, or comes back.

    The rule stands in `tests.model_of_moves.eager`.
    """
    after: dict[S, list[tuple[str, S]]] = {}
    waiting = [initial]
    while waiting:
        state = waiting.pop()
        if state not in after:
            after[state] = list(successors(state))
            waiting += [follower for _, follower in after[state]]
    if _comes_back(initial, after):
        yield "a state comes back"
    for state, followers in after.items():
        for name, eager in followers:
            if is_eager(state, name):
                if visible(eager) != visible(state):
                    yield f"{name} is seen: {state}"
                for other in _left_out(after, state, name, eager):
                    yield f"{name} and {other}: {state}"


def _left_out(
    after: Mapping[S, list[tuple[str, S]]], state: S, name: str, eager: S
) -> Iterator[str]:
    """Yield the steps that a state loses when it takes `name` to `eager` alone."""
    soon = {follower for _, follower in after[eager]}
    later = {follower for each in soon for _, follower in after[each]}
    for other, then in after[state]:
        meets = any(k == name and f in soon for k, f in after[then])
        if not (then == eager or then in soon or meets or then in later):
            yield other


def _comes_back(initial: S, after: Mapping[S, list[tuple[str, S]]]) -> bool:
    """Return whether a way leads from a state back to it."""
    open_, done = set[S](), set[S]()
    way = [(initial, False)]
    while way:
        state, is_left = way.pop()
        if is_left:
            open_.discard(state)
            done.add(state)
        elif state in open_:
            return True
        elif state not in done:
            open_.add(state)
            way.append((state, True))
            way += [(follower, False) for _, follower in after[state]]
    return False


def _chosen(
    state: S, successors: Successors[S], is_eager: IsEager[S]
) -> Sequence[tuple[str, S]]:
    """Return what may happen next, or one eager step alone."""
    followers = []
    for follower in successors(state):
        if is_eager(state, follower[0]):
            return (follower,)
        followers.append(follower)
    return followers


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
