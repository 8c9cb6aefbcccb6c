"""What a robot is, and the file that describes it."""

from poise.model.load import load

__all__ = ["load"]
