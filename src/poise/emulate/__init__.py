"""One Linux machine as a robot's several computers (docs/emulation.md)."""

from poise.emulate.computer import EmulatedComputer
from poise.emulate.emulation import Emulation
from poise.emulate.probe import Probe, look
from poise.emulate.registry import sweep
from poise.emulate.starvation import StarvationWatch
from poise.emulate.usage import Usage, is_starved

__all__ = [
    "EmulatedComputer",
    "Emulation",
    "Probe",
    "StarvationWatch",
    "Usage",
    "is_starved",
    "look",
    "sweep",
]
