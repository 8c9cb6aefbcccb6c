"""The process that runs a policy's own function, so that it can hold up nothing else.

It ends by itself when the function takes too long, even in native code, and when its
manager is gone.
"""

from __future__ import annotations

import importlib
import operator
import select
import signal
import socket
import sys
import traceback
from collections.abc import Callable, Iterable

from msgspec import Struct

from poise.errors import Unavailable
from poise.model.policy import PolicyAction, Seen
from poise.wire import frame

LIMIT = 1.0
"""A function that takes longer is ended [s]."""
IMPORT_LIMIT = 20.0
"""The same for the import of its module [s]."""


class FunctionAnswer(Struct, frozen=True):
    """What a function wants done, or its error."""

    actions: tuple[PolicyAction, ...] = ()
    error: str = ""


def main(reference: str, folder: str, descriptor: str) -> None:
    """Answer what the manager asks, until it is gone."""
    sys.path.insert(0, folder)
    with socket.socket(fileno=int(descriptor)) as manager:
        signal.setitimer(signal.ITIMER_REAL, IMPORT_LIMIT)
        function, error = _imported(reference)
        while True:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            select.select([manager], [], [])
            try:
                seen = frame.receive_record(manager, Seen)
                signal.setitimer(signal.ITIMER_REAL, LIMIT)
                answer = FunctionAnswer(error=error)
                if function is not None:
                    answer = _answer(function, seen)
                frame.send_record(manager, answer)
            except Unavailable:
                return


def _imported(
    reference: str,
) -> tuple[Callable[[Seen], Iterable[object] | None] | None, str]:
    module, _, name = reference.partition(":")
    try:
        return operator.attrgetter(name)(importlib.import_module(module)), ""
    except Exception:  # noqa: BLE001, it is the user's code
        return None, traceback.format_exc()


def _answer(
    function: Callable[[Seen], Iterable[object] | None], seen: Seen
) -> FunctionAnswer:
    try:
        answers = tuple(function(seen) or ())
    except Exception:  # noqa: BLE001, it is the user's code
        return FunctionAnswer(error=traceback.format_exc())
    actions = [action for action in answers if isinstance(action, PolicyAction)]
    if wrong := [action for action in answers if not isinstance(action, PolicyAction)]:
        return FunctionAnswer(error=f"it returned {wrong[0]!r}, not a PolicyAction")
    return FunctionAnswer(tuple(actions))


if __name__ == "__main__":
    main(*sys.argv[1:])
