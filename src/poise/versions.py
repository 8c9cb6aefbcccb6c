"""Says which Poise is needed for what a newer one wrote."""

from __future__ import annotations

import re
from importlib.metadata import version

_MINOR = re.compile(r"(\d+)\.(\d+)(\.\w+)*")


def why_too_old(least: str) -> str:
    """Return why this Poise cannot read what needs a version; empty: it can."""
    own = version("poise")
    if _minor(least) <= _minor(own):
        return ""
    return f"it needs Poise {least}, and this is {own}: install the newer one"


def _minor(text: str) -> tuple[int, int]:
    found = _MINOR.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r} is no version, such as 0.2")
    return int(found[1]), int(found[2])
