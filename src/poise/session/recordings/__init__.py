"""Records what a run used and what its architectures sent, and reads it again."""
