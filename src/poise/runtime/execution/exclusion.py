"""Mutual exclusion of call chains in a component.

It is ROS 2's mutually exclusive callback group, with re-entrance. A *chain* begins with
a timer or a message, and goes on through every call made in it, in any container. A
chain that comes back to a component in which it waits may enter again; others wait.

The code is native, because every call runs it: `poise.runtime._calls` describes it, and
``tests/runtime/reference.py`` is the same in Python, held against it by tests.
"""

from __future__ import annotations

import os

from poise.runtime._calls import (
    Exclusion,
    begin_chains,
    current_chain,
    join_chain,
    new_chain,
)

__all__ = ["Exclusion", "Redirected", "current_chain", "join_chain", "new_chain"]


class Redirected(Exception):
    """The component has moved; its caller sends the call to the new place.

    Never reaches a component's code.
    """


def _begin_chains() -> None:
    # 28 random bits tell processes apart, 36 bits last for years of chains
    begin_chains((int.from_bytes(os.urandom(4)) >> 4) << 36 | 1)


_begin_chains()
os.register_at_fork(after_in_child=_begin_chains)
