"""What should run on which computer: told to agents, started, taken over, stopped."""
