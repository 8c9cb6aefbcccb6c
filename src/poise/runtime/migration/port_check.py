"""Whether code has the ports that the code whose place it takes is connected by."""

from __future__ import annotations

from collections.abc import Mapping

from poise.errors import UsageError
from poise.runtime.component.implementation import fingerprint
from poise.runtime.component.ports import Port


def check_ports(
    component: str, before: Mapping[str, Port], after: Mapping[str, Port]
) -> None:
    """Raise UsageError when the connectors of the code before do not fit other code.

    They do where the robot's check would let both have them: a port has the type that
    it had, and no port needs a connector that there is not.
    """
    for name, port in after.items():
        known = before.get(name)
        end = f"'{component}.{name}' {_shown(port)}"
        if known is not None and _meaning(known) != _meaning(port):
            raise UsageError(f"the types differ: {end}, and before {_shown(known)}")
        if known is None and port.kind in {"requires", "subscribes"}:
            raise UsageError(f"{end}, but no connector joins it")


def _meaning(port: Port) -> object:
    return port.kind, fingerprint(port.type)


def _shown(port: Port) -> str:
    return f"{port.kind} {getattr(port.type, '__qualname__', port.type)}"
