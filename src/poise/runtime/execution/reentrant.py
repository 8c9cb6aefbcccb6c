"""Calls that a re-entrant component makes: meanwhile others may call it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from poise.errors import Timeout
from poise.runtime.execution.exclusion import Exclusion, current_chain

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
            log.warning("a call waits to come back: %s", error)
        else:
            return
