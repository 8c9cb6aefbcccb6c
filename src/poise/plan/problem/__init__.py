"""What is to be decided: written, read, made from a robot, checked, and as arrays."""
