"""Poise keeps a robot's software in balance over its on-board computers."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from poise.clock import Stamp as Stamp
    from poise.runtime.component.component import Component as Component
    from poise.runtime.component.deadline import time_left as time_left
    from poise.runtime.component.deadline import within as within
    from poise.runtime.component.ports import Message as Message
    from poise.runtime.component.ports import Provided as Provided
    from poise.runtime.component.ports import Published as Published
    from poise.runtime.component.ports import Required as Required
    from poise.runtime.component.ports import every as every
    from poise.runtime.component.ports import oneway as oneway
    from poise.runtime.component.ports import subscribed as subscribed
    from poise.wire.connections.loans import loan as loan
else:
    _HOMES = {
        "Component": "poise.runtime.component.component",
        "Message": "poise.runtime.component.ports",
        "Provided": "poise.runtime.component.ports",
        "Published": "poise.runtime.component.ports",
        "Required": "poise.runtime.component.ports",
        "Stamp": "poise.clock",
        "every": "poise.runtime.component.ports",
        "loan": "poise.wire.connections.loans",
        "oneway": "poise.runtime.component.ports",
        "subscribed": "poise.runtime.component.ports",
        "time_left": "poise.runtime.component.deadline",
        "within": "poise.runtime.component.deadline",
    }
    __all__ = list(_HOMES)

    def __getattr__(name: str) -> object:
        """Import a name when it is first asked for: until then Ctrl-C has no answer."""
        if name not in _HOMES:
            raise AttributeError(f"module 'poise' has no attribute '{name}'")
        found = globals()[name] = getattr(import_module(_HOMES[name]), name)
        return found
