"""Tasks: their steps, the phases that they go through, and what excludes what."""
