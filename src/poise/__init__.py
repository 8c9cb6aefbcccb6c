"""Poise keeps a robot's software in balance over its on-board computers."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from poise.clock import Stamp
    from poise.runtime.component import Component
    from poise.runtime.deadline import time_left, within
    from poise.runtime.ports import (
        Message,
        Provided,
        Published,
        Required,
        every,
        oneway,
        subscribed,
    )
    from poise.wire.loans import loan
else:
    _HOMES = {
        "Component": "poise.runtime.component",
        "Message": "poise.runtime.ports",
        "Provided": "poise.runtime.ports",
        "Published": "poise.runtime.ports",
        "Required": "poise.runtime.ports",
        "Stamp": "poise.clock",
        "every": "poise.runtime.ports",
        "loan": "poise.wire.loans",
        "oneway": "poise.runtime.ports",
        "subscribed": "poise.runtime.ports",
        "time_left": "poise.runtime.deadline",
        "within": "poise.runtime.deadline",
    }

    def __getattr__(name: str) -> object:
        """Import a name when it is first asked for: until then Ctrl-C has no answer."""
        if name not in _HOMES:
            raise AttributeError(f"module 'poise' has no attribute '{name}'")
        found = globals()[name] = getattr(import_module(_HOMES[name]), name)
        return found


__all__ = [
    "Component",
    "Message",
    "Provided",
    "Published",
    "Required",
    "Stamp",
    "every",
    "loan",
    "oneway",
    "subscribed",
    "time_left",
    "within",
]
