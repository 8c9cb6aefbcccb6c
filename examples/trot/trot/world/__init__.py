"""The simulated robot and its home: ``python -m trot.world``."""
