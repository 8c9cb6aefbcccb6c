"""How large messages are, and what it costs to send and to take them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from msgspec import Struct

from poise.estimate.profile import ConnectorProfile, KindCosts
from poise.simulation._engine import Connector, Engine
from poise.wire.records.deployment import ConnectorSpec

End = Literal["source", "target"]
SIZE = 200.0
"""Of a message whose connector does not say it [bytes]."""


class Traffic(Struct, frozen=True, kw_only=True):
    """What goes over the connectors of a robot.

    Parameters
    ----------
    sizes
        Connector -> size of a message, or of a call both ways [bytes].
    calling
        The connectors over which calls go.
    costs
        Kind of connector -> what it costs, as `poise calibrate` measures it.
    """

    sizes: Mapping[str, float] = {}
    calling: frozenset[str] = frozenset()
    costs: Mapping[str, KindCosts] = {}

    def cost(self, connector: str, kind: str, together: str, end: End) -> float:
        """Return the work of one message or call beyond what it costs together.

        Parameters
        ----------
        kind
            The connector's: ``direct``, ``local`` or ``remote``.
        together
            Its kind when both ends are on one computer: so it was profiled.
        """
        is_call = connector in self.calling
        one = ConnectorProfile(
            calls=float(is_call),
            messages=float(not is_call),
            size=self.sizes.get(connector, 0.0),
        )
        now, then = (
            getattr(self.costs.get(each, KindCosts()), end).load(one)
            for each in (kind, together)
        )
        return max(0.0, float(now - then))

    def apart(self, connector: str, together: str) -> float:
        """Return what both ends work more for a message or call when they are apart."""
        return self.cost(connector, "remote", together, "source") + self.cost(
            connector, "remote", together, "target"
        )

    def size_of(self, connector: str) -> float:
        """Return the size of a message, or of a call both ways [bytes]."""
        return self.sizes.get(connector, SIZE)

    def connector_in(
        self, engine: Engine, spec: ConnectorSpec, together: str
    ) -> Connector:
        """Return a connector as the engine has it; `together` as for `cost`."""
        return engine.connector(
            name=spec.name,
            key=spec.key,
            slot=spec.slot or spec.name,
            source=(spec.source, spec.source_epoch),
            target=(spec.target, spec.target_epoch),
            computer=spec.target_computer,
            is_direct=spec.kind == "direct",
            limit=spec.limit,
            size=self.size_of(spec.name),
            costs=(
                self.cost(spec.name, spec.kind, together, "source"),
                self.cost(spec.name, spec.kind, together, "target"),
            ),
            carries=spec.carries,
            answers=spec.answers,
        )
