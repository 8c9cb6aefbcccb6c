"""The task manager: which actions run now, what ends them, and what comes next."""
