"""What a component sees of a required port: an object with the interface's methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

from poise.errors import Unavailable
from poise.runtime.connectors.interface import Method
from poise.suggest import did_you_mean, listed


class Proxy:
    """What a required port holds: the interface's methods as attributes."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __getattr__(self, name: str) -> NoReturn:
        """Name the methods that exist; Python asks only for one that does not."""
        known = [each for each in vars(self) if not each.startswith("_")]
        raise AttributeError(
            f"{self._what} has no method '{name}'{did_you_mean(name, known)}; "
            f"methods: {listed(known)}"
        )


def refusing(what: str) -> Callable[..., NoReturn]:
    """Return a function that raises `Unavailable`, however it is called."""

    def call(*_: object, **__: object) -> NoReturn:
        raise Unavailable(f"'{what}' is not connected")

    return call


def oneway_function(
    method: Method, send: Callable[[object, Method], None]
) -> Callable[..., None]:
    """Return a function that sends the arguments of a one-way call."""

    def call(*args: Any, **kwargs: Any) -> None:  # noqa: ANN401, the call's own
        send(method.bind(*args, **kwargs), method)

    return call
