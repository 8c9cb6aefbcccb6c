"""The records of a recording: samples, and inputs that came over connectors."""

from __future__ import annotations

from msgspec import Struct

from poise.wire.records.samples import AgentSample


class Input(Struct, frozen=True, array_like=True):
    """A message that was published, or a call that came.

    Parameters
    ----------
    source
        ``component.port`` that published it, or that called.
    at
        When it came [s], since the recording began.
    body, buffers
        It, or the arguments, encoded (`poise.wire.codec`); buffers end to end.
    tag
        Of a call: which method (`poise.runtime.connectors.interface`).
    result
        What a call returned, encoded without its arrays; empty: it failed, or nobody
        waited for it.
    """

    source: str
    at: float
    body: bytes
    buffers: bytes
    tag: int | None = None
    result: bytes = b""


class Recorded(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that was recorded of one run, oldest first.

    Parameters
    ----------
    samples
        What the agents sampled.
    inputs
        What was published between architectures, and called.
    seen
        What policies saw, five times a second: `poise.model.policy.seen.Seen`, as
        msgpack, compressed by zlib.
    """

    version: int = 1
    robot: str
    samples: list[AgentSample] = []
    inputs: list[Input] = []
    seen: list[bytes] = []
