"""How much of what the running actions leave free may be used for the next ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Struct

from poise.model.file_keys import Share, says, written


class Prefetch(Struct, frozen=True, kw_only=True):
    """What the next actions need is prepared: forked, imported, configured, inactive.

    The other half of the memory is for what grows, and for moves. Half of the CPU is
    enough to be ready soon; on emulated computers it comes from the same quota as that
    of the actions that run.
    """

    memory: Annotated[
        Share,
        says("Prepared components use at most this share of the memory left.", le=1),
    ] = 0.5
    cpu: Annotated[
        Share,
        says("Preparing uses at most this share of the CPU left.", gt=0, le=1),
    ] = 0.5
    off: bool = False


def _read(value: Literal["off"] | Mapping[str, float]) -> Mapping[str, object]:
    return {"off": True} if isinstance(value, str) else value


PREFETCH = written(Literal["off"] | Prefetch, _read)
"""How it is written: the two shares, or `off`."""
