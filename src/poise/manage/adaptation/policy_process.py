"""The process that runs a policy's own function, so that it can hold up nothing else.

It ends by itself when the function takes too long, even in native code, and when its
manager is gone.
"""

from __future__ import annotations

import importlib
import operator
import signal
import socket
import sys
import traceback
from collections.abc import Callable, Iterable

import msgspec
from msgspec import Struct

from poise.decoding import convert
from poise.errors import Unavailable, unknown
from poise.model.policy import PolicyAction, Seen
from poise.waker import wait_readable
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
            wait_readable([manager.fileno()], None)
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
        answers = function(seen) or ()
        if isinstance(answers, str | PolicyAction):
            return FunctionAnswer(error=f"it returned {answers!r}, not a list")
        answers = tuple(answers)
    except Exception:  # noqa: BLE001, it is the user's code
        return FunctionAnswer(error=traceback.format_exc())
    errors = (_why_wrong(answer, seen) for answer in answers)
    if error := next(filter(None, errors), ""):
        return FunctionAnswer(error=error)
    return FunctionAnswer(tuple(a for a in answers if isinstance(a, PolicyAction)))


def _why_wrong(answer: object, seen: Seen) -> str:
    """Return why what a function returned is no action; empty: it is one."""
    if not isinstance(answer, PolicyAction):
        return f"it returned {answer!r}, not a PolicyAction"
    try:  # nothing has checked the types of its fields
        convert(msgspec.to_builtins(answer), PolicyAction)
    except (TypeError, ValueError) as error:
        return f"it returned {answer!r}: {error}"
    computers = [computer.name for computer in seen.computers]
    if answer.do == "move" and answer.to not in computers:
        return f"it moves '{answer.about}': {unknown('computer', answer.to, computers)}"
    return ""


if __name__ == "__main__":
    main(*sys.argv[1:])
