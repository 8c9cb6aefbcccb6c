"""The readable reference of objective, limits and greedy: what the core must match."""
