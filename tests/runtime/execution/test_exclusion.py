"""The native exclusion does what the one in Python does, also under many threads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.errors import Timeout
from poise.runtime.execution.exclusion import (
    Exclusion,
    Redirected,
    current_chain,
    join_chain,
    new_chain,
)
from tests.runtime import reference

LONG = 20.0
"""A limit that only a broken exclusion reaches [s]."""

CHAINS = st.integers(0, 3)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("enter"), CHAINS),
        st.tuples(st.sampled_from(["leave", "resume", "pause", "redirect"])),
        st.tuples(st.just("lend"), CHAINS),
        st.tuples(st.just("step_out"), CHAINS),
        st.tuples(st.just("step_in"), st.integers(1, 3), st.integers(0, 2)),
    ),
    max_size=30,
)


def outcome(exclusion: Any, step: tuple[Any, ...]) -> str:
    """Do a step without waiting and say how it ended."""
    action, *args = step
    if action in {"enter", "pause", "step_in"}:
        args.append(0.0)
    try:
        told = getattr(exclusion, action)(*args)
    except (Timeout, Redirected, RuntimeError) as error:
        return f"{type(error).__name__}: {error}"
    return f"done: {told}"


@pytest.fixture(params=[Exclusion, reference.Exclusion], ids=["native", "reference"])
def exclusion(request: pytest.FixtureRequest) -> Any:
    """Give an open exclusion, native and in Python."""
    made = request.param("callee")
    made.resume()
    return made


def start(work: Callable[[], object]) -> threading.Thread:
    """Start a thread and wait until it has begun."""
    begun = threading.Event()

    def run() -> None:
        begun.set()
        work()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert begun.wait(LONG)
    return thread


@pytest.mark.slow
@given(STEPS)
def test_agrees_with_the_reference(steps: list[tuple[Any, ...]]) -> None:
    native, readable = Exclusion("callee"), reference.Exclusion("callee")
    for step in steps:
        if step[0] == "step_in" and readable.num_outside < 1:
            continue  # only who stepped out steps in again
        assert outcome(native, step) == outcome(readable, step), step


def test_lets_nobody_in_before_it_is_resumed() -> None:
    with pytest.raises(Timeout, match="'callee' was busy for 0 s"):
        Exclusion("callee").enter(1, 0)


def test_lets_a_chain_enter_again_and_no_other(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    exclusion.enter(1, 0)
    exclusion.leave()
    with pytest.raises(Timeout):
        exclusion.enter(2, 0)
    exclusion.leave()
    exclusion.enter(2, 0)


def test_does_not_take_chain_zero_for_nobody(exclusion: Any) -> None:
    exclusion.pause(0)
    with pytest.raises(Timeout):
        exclusion.enter(0, 0)


def test_gives_up_after_the_limit(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    with pytest.raises(Timeout, match=r"'callee' was busy for 0.02 s"):
        exclusion.enter(2, 0.02)
    exclusion.leave()
    exclusion.enter(3, 0)  # the one that gave up is not handed the exclusion


def test_hands_the_exclusion_to_one_that_waits(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    entered: list[int] = []

    def work() -> None:
        exclusion.enter(2, LONG)
        entered.append(2)
        exclusion.leave()

    thread = start(work)
    exclusion.leave()
    thread.join(LONG)
    assert entered == [2]


def test_refuses_those_who_wait_when_it_is_redirected(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    sent_away: list[int] = []

    def work(chain: int) -> None:
        try:
            exclusion.enter(chain, LONG)
        except Redirected:
            sent_away.append(chain)

    threads = [start(partial(work, chain)) for chain in (2, 3)]
    exclusion.redirect()
    for thread in threads:
        thread.join(LONG)
    assert sorted(sent_away) == [2, 3]
    with pytest.raises(Redirected, match="'callee' has moved away"):
        exclusion.enter(4, LONG)
    exclusion.enter(1, 0)  # it is inside and may come back


def test_pauses_only_when_nobody_is_inside(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    with pytest.raises(Timeout, match="did not pause within 0 s"):
        exclusion.pause(0)
    exclusion.leave()
    exclusion.pause(0)
    exclusion.lend(5)
    exclusion.enter(5, 0)


@pytest.mark.slow
def test_lets_one_chain_in_at_a_time_under_many_threads(exclusion: Any) -> None:
    """Eight threads add to one number without another lock; none is lost."""
    total = 0

    def work() -> None:
        nonlocal total
        for _ in range(2000):
            chain = new_chain()
            exclusion.enter(chain, LONG)
            exclusion.enter(chain, LONG)
            before = total
            if before % 50 == 0:
                threading.Event().wait(1e-6)  # give the GIL to the others
            total = before + 1
            exclusion.leave()
            exclusion.leave()

    with ThreadPoolExecutor(8) as pool:
        for future in [pool.submit(work) for _ in range(8)]:
            future.result(LONG)
    assert total == 8 * 2000


def test_survives_limits_that_end_in_a_hand_over(
    exclusion: Any,
) -> None:
    """Threads give up at about the moment they may enter; it is never lost."""
    entered = 0

    def work() -> None:
        nonlocal entered
        for number in range(500):
            try:
                exclusion.enter(new_chain(), number % 5 * 2e-5)
            except Timeout:
                continue
            entered += 1
            exclusion.leave()

    with ThreadPoolExecutor(6) as pool:
        for future in [pool.submit(work) for _ in range(6)]:
            future.result(LONG)
    assert entered > 0
    exclusion.enter(1, 0)


def test_gives_each_thread_a_chain_of_its_own() -> None:
    join_chain(7)
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(current_chain).result(LONG)
    assert current_chain() == 7
    assert other not in {0, 7}
    assert new_chain() != 7


def test_lets_others_in_while_a_chain_steps_out(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    exclusion.enter(1, 0)
    depth = exclusion.step_out(1)
    exclusion.enter(2, 0)
    with pytest.raises(Timeout):
        exclusion.step_in(1, depth, 0)
    exclusion.leave()
    exclusion.step_in(1, depth, 0)
    exclusion.leave()
    with pytest.raises(Timeout):
        exclusion.enter(2, 0)
    exclusion.leave()
    exclusion.enter(2, 0)


def test_is_not_paused_before_those_that_stepped_out_came_back(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    depth = exclusion.step_out(1)
    with ThreadPoolExecutor() as pool:
        shut = pool.submit(exclusion.pause, LONG)
        for chain in (2, 1):  # whom it waits for must come in
            exclusion.enter(chain, LONG)
            exclusion.leave()
        assert not shut.done()
        exclusion.step_in(1, depth, LONG)
        exclusion.leave()
        shut.result(LONG)
    with pytest.raises(Timeout):
        exclusion.enter(2, 0)


def test_steps_out_of_nothing_in_a_hook_or_on_a_foreign_thread(exclusion: Any) -> None:
    assert exclusion.step_out(1) == -1
    exclusion.pause(0)
    exclusion.lend(1)
    assert exclusion.step_out(1) == -1


def test_comes_back_though_it_is_redirected(exclusion: Any) -> None:
    exclusion.enter(1, 0)
    depth = exclusion.step_out(1)
    exclusion.enter(2, 0)
    with ThreadPoolExecutor() as pool:
        back = pool.submit(exclusion.step_in, 1, depth, LONG)
        exclusion.redirect()
        exclusion.leave()
        back.result(LONG)
