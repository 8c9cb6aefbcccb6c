"""What the cases over zenoh share."""

from __future__ import annotations

import time

import zenoh

ADDRESS = "tcp/127.0.0.1:17447"


def wait_matching(entity: zenoh.Querier | zenoh.Publisher) -> None:
    """Wait until somebody receives what it sends."""
    end = time.monotonic() + 10
    while not getattr(entity.matching_status, "matching", False):
        if time.monotonic() > end:
            raise RuntimeError(f"nobody receives {entity.key_expr}")
        time.sleep(0.01)
