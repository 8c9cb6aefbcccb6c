"""Too little room: what is suspended, and what fits beside the rest."""
