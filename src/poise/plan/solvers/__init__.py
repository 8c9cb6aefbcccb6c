"""Which solver when, and which of several architectures."""
