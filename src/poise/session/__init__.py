"""The application as a library: `poise.load`, `place`, `run`, `up`, `profile` ...

Here is how a function that takes long says what it does, and how it is ended early.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

Say = Callable[[str], object]
"""Takes a sentence."""

log = logging.getLogger("poise")
"""Takes sentences by default."""

Check = Callable[[], object]
"""Called several times a second while a function waits; may raise to end that."""


def nothing(*_: object) -> None:
    """Let a function go on; or say nothing."""
