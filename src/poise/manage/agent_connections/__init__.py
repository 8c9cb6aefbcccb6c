"""The manager's agents: what it asks, what they report, and who is reached."""
