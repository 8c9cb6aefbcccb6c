"""How often actions succeed with an architecture, learned from their outcomes."""

from poise.estimate.success.posterior import Posterior
from poise.estimate.success.store import Ending, Outcome, Situation, SuccessStore

__all__ = ["Ending", "Outcome", "Posterior", "Situation", "SuccessStore"]
