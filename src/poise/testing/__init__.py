"""What users may use in tests of their own components: a bench and a clock."""

from poise.testing.bench import Bench
from poise.testing.virtual_clock import VirtualClock

__all__ = ["Bench", "VirtualClock"]
