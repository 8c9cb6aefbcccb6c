"""How a function that takes long says what it does."""

from __future__ import annotations

import logging
from collections.abc import Callable

Say = Callable[[str], object]
"""Takes a sentence."""

log = logging.getLogger("poise")
"""Takes sentences where nobody else does."""
