"""One thread at a time runs a chain in a process, and nobody waits for ever."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from poise.errors import CalleeError, Timeout
from poise.runtime._calls import ServedCall, call_remote, called
from poise.runtime.connectors.route import direct_call, raise_callee_error
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.exclusion import (
    Exclusion,
    Redirected,
    current_chain,
    new_chain,
)
from poise.wire.frame import Frame, FrameKind, Pieces
from tests.waiting import wait_until

LONG = 20.0
SHORT = 0.02


@pytest.fixture
def others() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor() as pool:
        yield pool


def open_exclusion() -> Exclusion:
    exclusion = Exclusion("callee")
    exclusion.resume()
    return exclusion


def call_frame(chain: int) -> Frame:
    return Frame(
        FrameKind.CALL, 0, 0, chain, b"body", memoryview(b"buffers"), 0, 0.0, 0.0
    )


def come_in(
    chain: int,
    limit: float,
    work: Callable[..., Any] = lambda *_: b"answer",
    *,
    exclusion: Exclusion | None = None,
    counts: Counts | None = None,
) -> Any:
    """Let a call of a component that is not at work come in, and return the answer."""
    served = ServedCall(
        decode=lambda body, buffers: (body, bytes(buffers)),
        method=work,
        encode=lambda result: [result],
        exclusion=exclusion or open_exclusion(),
        limit=limit,
        counts=counts or Counts(),
        translate=raise_callee_error,
        is_over=lambda: False,
    )
    return served(call_frame(chain))


def comes_in(chain: int, limit: float) -> bool:
    try:
        return bool(come_in(chain, limit) == [b"answer"])
    except Timeout:
        return False


def go(chain: int, limit: float, meanwhile: Callable[[], Any]) -> Any:
    """Call elsewhere, where something else happens `meanwhile`."""

    def request(pieces: Pieces, seconds: float) -> Any:
        assert (pieces, seconds) == ([b"call"], limit)
        return meanwhile()

    return call_remote(chain, limit, "a-b", request, [b"call"])


def test_whose_code_runs_is_known_amid_calls_within_calls() -> None:
    outer, inner = open_exclusion(), Exclusion("inner")
    inner.resume()
    seen = [called()]

    def ask(*_: object) -> bytes:
        seen.append(called())
        call = direct_call(lambda: seen.append(called()), inner, LONG, Counts())
        call()
        seen.append(called())
        return b"answer"

    come_in(new_chain(), LONG, ask, exclusion=outer)
    assert [*seen, called()] == ["", "callee", "inner", "callee", ""]


def test_a_call_is_decoded_run_and_encoded_in_its_chain() -> None:
    def work(*arguments: object) -> Any:
        return (*arguments, current_chain())

    assert come_in(77, LONG, work) == [(b"body", b"buffers", 77)]


def test_what_the_callee_raises_is_translated_and_leaves_the_way_free() -> None:
    exclusion = open_exclusion()

    def fail(*_: object) -> None:
        raise ValueError("no")

    with pytest.raises(CalleeError, match="no") as caught:
        come_in(7, LONG, fail, exclusion=exclusion)
    assert "in fail" in caught.value.traceback
    assert come_in(8, LONG, exclusion=exclusion) == [b"answer"]


def test_a_component_that_moved_away_is_not_called() -> None:
    exclusion = open_exclusion()
    exclusion.redirect()
    with pytest.raises(Redirected):
        come_in(7, LONG, pytest.fail, exclusion=exclusion)


def test_a_component_that_is_busy_is_named() -> None:
    exclusion = open_exclusion()
    exclusion.enter(new_chain(), LONG)
    with pytest.raises(Timeout, match=r"component 'callee' was busy for 0(\.0\d+)? s"):
        come_in(7, SHORT, exclusion=exclusion)


def test_the_cpu_time_of_long_calls_is_exact() -> None:
    counts = Counts()
    burnt = 0.002

    def burn(*_: object) -> bytes:
        end = time.thread_time() + burnt
        while time.thread_time() < end:
            pass
        return b""

    began = time.thread_time()
    for _ in range(5):
        come_in(7, LONG, burn, counts=counts)
    assert 5 * burnt <= counts.cpu <= time.thread_time() - began


def test_a_chain_may_come_back_while_its_thread_waits(
    others: ThreadPoolExecutor,
) -> None:
    chain = new_chain()

    def work(*_: object) -> bytes:
        assert not others.submit(comes_in, chain, SHORT).result(LONG)
        assert go(chain, LONG, others.submit(comes_in, chain, LONG).result)
        assert not others.submit(comes_in, chain, SHORT).result(LONG)
        return b"done"

    assert come_in(chain, LONG, work) == [b"done"]
    assert others.submit(comes_in, chain, LONG).result(LONG)


def test_what_comes_back_late_does_not_come_in_where_the_chain_began(
    others: ThreadPoolExecutor,
) -> None:
    chain = new_chain()
    for _ in range(2):
        assert go(chain, LONG, others.submit(comes_in, chain, LONG).result)
        assert not others.submit(comes_in, chain, SHORT).result(LONG)


def test_a_chain_whose_first_thread_ended_comes_in(others: ThreadPoolExecutor) -> None:
    chain = new_chain()
    beginning = threading.Thread(target=go, args=(chain, LONG, lambda: None))
    beginning.start()
    beginning.join(LONG)
    # `join` returns a little before the thread's end
    wait_until(lambda: not Path(f"/proc/self/task/{beginning.native_id}").exists())
    assert others.submit(comes_in, chain, LONG).result(LONG)


def test_an_error_of_the_request_goes_on() -> None:
    def fail() -> None:
        raise Timeout("no answer")

    with pytest.raises(Timeout, match="no answer"):
        go(new_chain(), LONG, fail)


@pytest.mark.parametrize("error", [None, ValueError("why")])
def test_who_was_called_back_and_does_not_end_is_named(
    others: ThreadPoolExecutor, error: Exception | None
) -> None:
    chain = new_chain()
    inside, go_on = threading.Event(), threading.Event()

    def stay(*_: object) -> bytes:
        inside.set()
        assert go_on.wait(LONG)
        return b""

    def meanwhile() -> Any:
        staying = others.submit(come_in, chain, LONG, stay)
        assert inside.wait(LONG)
        if error is not None:
            raise error
        return staying

    late = r"connector a-b: .* still runs after 0.02 s"
    with pytest.raises(Timeout, match=late) as caught:
        go(chain, SHORT, meanwhile)
    assert caught.value.__cause__ is error
    go_on.set()
    go(chain, LONG, lambda: None)  # and from now on all is as before
    assert not others.submit(comes_in, chain, SHORT).result(LONG)


@pytest.mark.slow
def test_a_call_and_a_call_back_of_it_share_one_limit(
    others: ThreadPoolExecutor,
) -> None:
    chain, limit = new_chain(), 2.0
    inside, go_on = threading.Event(), threading.Event()

    def stay(*_: object) -> bytes:
        inside.set()
        assert go_on.wait(LONG)
        return b""

    def meanwhile() -> None:
        others.submit(come_in, chain, LONG, stay)
        assert inside.wait(LONG)
        time.sleep(limit)

    began = time.monotonic()
    with pytest.raises(Timeout, match="still runs"):
        go(chain, limit, meanwhile)
    assert time.monotonic() - began < 2 * limit
    go_on.set()


def test_who_is_called_back_too_long_still_keeps_others_out(
    others: ThreadPoolExecutor,
) -> None:
    chain = new_chain()
    inside, go_on = threading.Event(), threading.Event()

    def stay(*_: object) -> bytes:
        inside.set()
        assert go_on.wait(LONG)
        return b""

    def meanwhile() -> Any:
        staying = others.submit(come_in, chain, LONG, stay)
        assert inside.wait(LONG)
        return staying

    def work(*_: object) -> Any:
        return go(chain, SHORT, meanwhile)

    with pytest.raises(CalleeError, match="a call back from it still runs"):
        others.submit(come_in, chain, LONG, work).result(LONG)
    assert not others.submit(comes_in, chain, SHORT).result(LONG)
    go_on.set()
    assert others.submit(comes_in, chain, LONG).result(LONG)
