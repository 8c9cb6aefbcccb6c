"""Which messages are new to a node that goes on with the work of another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from poise.ros2.arrivals import Arrivals


def info(stamp: int) -> Mapping[str, Any]:
    return {"publisher_gid": {"data": [7] * 16}, "source_timestamp": stamp}


def watched(arrivals: Arrivals, callback: Callable[..., Any]) -> Callable[..., Any]:
    subscription = SimpleNamespace(callback=callback)
    arrivals.watch(SimpleNamespace(subscriptions=[subscription]))
    taking: Callable[..., Any] = subscription.callback
    return taking


@pytest.mark.parametrize("kind", ["plain", "with info", "async"])
def test_each_kind_of_callback_takes_only_what_is_new(kind: str) -> None:
    took: list[str] = []

    def plain(message: str) -> None:
        took.append(message)

    def with_info(message: str, given: Mapping[str, Any]) -> None:
        assert given["source_timestamp"]
        took.append(message)

    async def waiting(message: str) -> None:
        took.append(message)

    kinds: dict[str, Callable[..., Any]] = {
        "plain": plain,
        "with info": with_info,
        "async": waiting,
    }
    callback = kinds[kind]
    before, after = Arrivals(), Arrivals()
    take, go_on = watched(before, callback), watched(after, callback)

    def give(take: Callable[..., Any], message: str, stamp: int) -> None:
        if (called := take(message, info(stamp))) is not None:
            with pytest.raises(StopIteration):
                called.send(None)

    give(take, "one", 100)
    after.go_on_from(before.stamps)
    give(go_on, "one", 100)
    give(go_on, "two", 200)
    assert took == ["one", "two"]


def test_subscriptions_to_one_topic_are_apart() -> None:
    arrivals = Arrivals()
    assert arrivals.is_new(info(100), 0)
    after = Arrivals()
    after.go_on_from(arrivals.stamps)
    assert not after.is_new(info(100), 0)
    assert after.is_new(info(100), 1)


def test_publishers_that_were_not_heard_for_long_are_forgotten() -> None:
    arrivals = Arrivals()
    for number in range(2000):
        gid = {"data": [number // 256, number % 256]}
        assert arrivals.is_new({"publisher_gid": gid, "source_timestamp": number})
        assert arrivals.is_new(info(number))
    assert len(arrivals.stamps) == 1000
    after = Arrivals()
    after.go_on_from(arrivals.stamps)
    assert not after.is_new(info(1999))
