"""Questions about other robots: other computers, other capacities, fewer computers."""
