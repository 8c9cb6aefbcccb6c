"""The manager: accepts a task, deploys what it needs, watches it, and stops it."""
