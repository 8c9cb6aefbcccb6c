"""Which messages of ROS 2 are new to what goes on with the work of another."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

_MOST = 1000
"""The most publishers whose stamps are kept: those heard last."""


class Arrivals:
    """When the last messages taken were published, which successors get, too.

    Each publisher stamps by the clock of its own computer [ns since 1970].
    """

    def __init__(self) -> None:
        self.stamps: dict[str, int] = {}
        self._before: dict[str, int] = {}

    def go_on_from(self, stamps: Mapping[str, int]) -> None:
        """Take for new what was published after `stamps`."""
        self.stamps, self._before = dict(stamps), dict(stamps)

    def is_new(self, info: Mapping[str, Any], subscription: int = 0) -> bool:
        """Return whether a message is new, which is taken then."""
        publisher = bytes(info["publisher_gid"]["data"]).hex()
        key, stamp = f"{subscription} {publisher}", info["source_timestamp"]
        if stamp <= self._before.get(key, -1):
            return False
        self._before.pop(key, None)  # its clock may be set back
        self.stamps.pop(key, None)  # the last heard comes last
        self.stamps[key] = stamp
        if len(self.stamps) > _MOST:
            del self.stamps[next(iter(self.stamps))]
        return True

    def watch(self, node: Any) -> None:  # noqa: ANN401, a node of rclpy
        """Let the subscriptions of a node take only what is new."""
        for index, subscription in enumerate(node.subscriptions):
            subscription.callback = self._filter(subscription.callback, index)

    def _filter(self, callback: Callable[..., Any], index: int) -> Callable[..., Any]:
        takes_info = _takes_info(callback)

        def call(message: object, info: Mapping[str, Any]) -> Any:  # noqa: ANN401, as it is
            if not self.is_new(info, index):
                return None
            return callback(message, info) if takes_info else callback(message)

        async def call_async(message: object, info: Mapping[str, Any]) -> None:
            if (called := call(message, info)) is not None:
                await called

        return call_async if inspect.iscoroutinefunction(callback) else call


def _takes_info(callback: Callable[..., Any]) -> bool:
    """Return whether rclpy calls it with what it knows of the message, too."""
    try:
        inspect.signature(callback).bind(object())
    except TypeError:
        return True
    return False
