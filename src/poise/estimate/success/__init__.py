"""How often actions succeed with an architecture, learned from their outcomes."""

from poise.estimate.success.outcome_store import (
    Conditions,
    Ending,
    Outcome,
    Posterior,
    SuccessStore,
)

__all__ = ["Conditions", "Ending", "Outcome", "Posterior", "SuccessStore"]
