"""Which solver when, which of several architectures, and an independent solver."""
