"""What a component sees of a required port: an object with the interface's methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from poise.errors import Unavailable
from poise.model.suggest import did_you_mean, listed


class Facade:
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
