"""What policies see of a running robot, and which of them apply."""
