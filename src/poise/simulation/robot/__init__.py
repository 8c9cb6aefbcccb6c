"""A simulated robot: the real manager and agents, with all that they need."""
