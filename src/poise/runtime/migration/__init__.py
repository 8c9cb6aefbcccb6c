"""A container's part in moving a component."""
