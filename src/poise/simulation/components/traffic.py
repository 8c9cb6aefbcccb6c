"""How large messages are, and what it costs to send and to take them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from msgspec import Struct

from poise.estimate.profile import ConnectorProfile, KindCosts
from poise.wire.records.deployment import ConnectorSpec


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

    def cost(
        self, spec: ConnectorSpec, together: str, side: Literal["source", "target"]
    ) -> float:
        """Return the work of one message or call beyond what it costs together.

        Parameters
        ----------
        together
            The connector's kind when both ends are on one computer: so it was profiled.
        """
        is_call = spec.name in self.calling
        one = ConnectorProfile(
            calls=float(is_call),
            messages=float(not is_call),
            size=self.sizes.get(spec.name, 0.0),
        )
        now, then = (
            getattr(self.costs.get(kind, KindCosts()), side).load(one)
            for kind in (spec.kind, together)
        )
        return max(0.0, float(now - then))
