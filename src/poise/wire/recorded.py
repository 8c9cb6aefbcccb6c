"""What stands in a recording: what was used, and what came over connectors."""

from __future__ import annotations

from msgspec import Struct

from poise.wire.samples import AgentSample


class Input(Struct, frozen=True, array_like=True):
    """A message that was published.

    Parameters
    ----------
    source
        ``component.port`` that published it.
    at
        When it came [s], since the recording began.
    body, buffers
        It, encoded (`poise.wire.codec`); buffers end to end.
    """

    source: str
    at: float
    body: bytes
    buffers: bytes


class Recorded(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that was recorded of one run, oldest first.

    Parameters
    ----------
    samples
        What agents told of what is used.
    inputs
        What was published between architectures.
    """

    version: int = 1
    robot: str
    samples: list[AgentSample] = []
    inputs: list[Input] = []
