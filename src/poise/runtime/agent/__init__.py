"""The agent: the program on each computer that runs containers."""
