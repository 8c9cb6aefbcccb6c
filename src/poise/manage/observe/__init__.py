"""What the manager knows and reports of a running robot."""
