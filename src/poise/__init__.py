"""Poise keeps a robot's software in balance over its on-board computers."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from poise.clock import Stamp as Stamp
    from poise.runtime.component import Component as Component
    from poise.runtime.deadline import time_left as time_left
    from poise.runtime.deadline import within as within
    from poise.runtime.ports import Message as Message
    from poise.runtime.ports import Provided as Provided
    from poise.runtime.ports import Published as Published
    from poise.runtime.ports import Required as Required
    from poise.runtime.ports import every as every
    from poise.runtime.ports import oneway as oneway
    from poise.runtime.ports import subscribed as subscribed
    from poise.wire.loans import loan as loan
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
    __all__ = list(_HOMES)

    def __getattr__(name: str) -> object:
        """Import a name when it is first asked for: until then Ctrl-C has no answer."""
        if name not in _HOMES:
            raise AttributeError(f"module 'poise' has no attribute '{name}'")
        found = globals()[name] = getattr(import_module(_HOMES[name]), name)
        return found
