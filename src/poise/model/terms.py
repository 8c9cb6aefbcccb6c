"""F, by which placements are compared, and its parts."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace


class Terms(Struct, frozen=True, kw_only=True):
    """F and its parts, weights included: they add up to `total`.

    `move` holds every linear cost: of leaving the present computer, and what problems
    say that a component costs on a computer. `quality` is what a lesser alternative
    costs, `shortage` what is used beyond soft limits, and `time` what is beyond time
    limits that have a price.
    """

    total: float
    communication: float
    balance: float
    move: float = 0.0
    quality: float = 0.0
    shortage: float = 0.0
    time: float = 0.0

    def __sub__(self, other: Terms) -> Terms:
        """Return by how much each term is more than `other`'s."""
        names = self.__struct_fields__
        return Terms(**{k: getattr(self, k) - getattr(other, k) for k in names})

    def with_quality(self, cost: float) -> Terms:
        """Return F with this cost of a lesser alternative, instead of any other."""
        return replace(self, total=self.total - self.quality + cost, quality=cost)
