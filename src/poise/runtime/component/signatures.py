"""Whether the methods of a component can take what Poise calls them with."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from types import FunctionType

from poise.errors import UsageError

_FUNCTIONS = (FunctionType, staticmethod, classmethod)


def check_takes(component: type, name: str, arguments: Sequence[str] = ()) -> None:
    """Raise UsageError when a method does not take as many arguments as Poise gives.

    Only functions are checked, and only by their own parameters: those written in C++,
    which have a signature of their own, are not.
    """
    method = inspect.getattr_static(component, name, None)
    if not isinstance(method, _FUNCTIONS) or hasattr(method, "__signature__"):
        return
    try:
        called = method.__get__(object(), component)
        inspect.signature(called, follow_wrapped=False).bind(*arguments)
    except (TypeError, ValueError):  # ValueError: it lacks `self`
        wanted = ", ".join(("self", *arguments))
        raise UsageError(
            f"{component.__qualname__}.{name} does not take what Poise calls it with; "
            f"write `def {name}({wanted})`, where further parameters need defaults"
        ) from None
