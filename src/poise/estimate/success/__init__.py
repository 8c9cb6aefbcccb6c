"""How often actions succeed with an architecture, learned from their outcomes."""

from poise.estimate.success.posterior import Posterior
from poise.estimate.success.store import Conditions, Ending, Outcome, SuccessStore

__all__ = ["Conditions", "Ending", "Outcome", "Posterior", "SuccessStore"]
