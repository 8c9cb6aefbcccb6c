"""Mutual exclusion of call chains in a component.

It is ROS 2's mutually exclusive callback group, with re-entrance: a *chain* begins with
a timer or a message, and may come back to a component in which it waits. The code is
native; ``tests/runtime/reference.py`` is the same in Python, and tests compare them.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from typing import Any

from poise.errors import Timeout
from poise.runtime._calls import (
    Exclusion,
    begin_chains,
    current_chain,
    join_chain,
    new_chain,
)

__all__ = ["Exclusion", "Redirected", "current_chain", "join_chain", "new_chain"]


class Redirected(Exception):
    """The component has moved; its caller sends the call to the new place."""


def _begin_chains() -> None:
    # 28 random bits tell processes apart, 36 bits last for years of chains
    begin_chains((int.from_bytes(os.urandom(4)) >> 4) << 36 | 1)


_begin_chains()
os.register_at_fork(after_in_child=_begin_chains)


log = logging.getLogger(__name__)

_PATIENCE = 1.0
"""While others are inside, a warning is logged this often [s]."""


def stepping_out(exclusion: Exclusion, call: Callable[..., Any]) -> Callable[..., Any]:
    """Return `call` with its caller's exclusion released meanwhile."""

    def around(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401, the call's own
        chain = current_chain()
        depth = exclusion.step_out(chain)
        if depth < 0:  # in a life-cycle hook, or on a thread of the user's own
            return call(*args, **kwargs)
        try:
            return call(*args, **kwargs)
        finally:
            _step_in(exclusion, chain, depth)

    return around


def _step_in(exclusion: Exclusion, chain: int, depth: int) -> None:
    """Wait as long as others are inside: outside the exclusion no code may run."""
    while True:
        try:
            exclusion.step_in(chain, depth, _PATIENCE)
        except Timeout as error:
            log.warning("a call waits to enter its component again: %s", error)
        else:
            return
