"""Where each component runs: the objective, the greedy, search, proof, explanation."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from poise.plan.public import *  # noqa: F403, they have no others
else:

    def __getattr__(name: str) -> object:
        """Import the planner when it is asked for: its records do not need it."""
        found = getattr(import_module("poise.plan.public"), name)
        globals()[name] = found
        return found
