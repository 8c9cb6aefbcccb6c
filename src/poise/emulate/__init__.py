"""One Linux machine as a robot's several computers (docs/emulation.md)."""

from poise.emulate.computer import EmulatedComputer
from poise.emulate.cpu_load import full_speed
from poise.emulate.emulated_set import EmulatedSet, all_sets, find_set, set_for
from poise.emulate.emulation import Emulation
from poise.emulate.layout import InjectedFault
from poise.emulate.probe import Probe, probe_host
from poise.emulate.registry import sweep
from poise.emulate.usage import StarvationWatch, Usage, is_starved

__all__ = [
    "EmulatedComputer",
    "EmulatedSet",
    "Emulation",
    "InjectedFault",
    "Probe",
    "StarvationWatch",
    "Usage",
    "all_sets",
    "find_set",
    "full_speed",
    "is_starved",
    "probe_host",
    "set_for",
    "sweep",
]
