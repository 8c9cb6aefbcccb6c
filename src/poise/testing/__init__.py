"""What users may use in tests of their own components: a bench and a clock."""

from poise.testing.bench import Bench, VirtualClock

__all__ = ["Bench", "VirtualClock"]
