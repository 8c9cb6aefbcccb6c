"""Placements of a task's phases: what stays, what moves between them."""
