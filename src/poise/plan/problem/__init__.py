"""What is to be decided: written, read, checked, changed, and as arrays."""
