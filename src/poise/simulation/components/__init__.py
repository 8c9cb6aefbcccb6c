"""Models of containers, their components and what those do."""
