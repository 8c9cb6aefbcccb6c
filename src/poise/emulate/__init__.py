"""One Linux machine as a robot's several computers (docs/emulation.md)."""

from poise.emulate.cgroups import Probe, probe_host
from poise.emulate.cpu_load import background_load, full_speed
from poise.emulate.emulated_set import EmulatedSet, all_sets, find_set, set_for
from poise.emulate.emulation import EmulatedComputer, Emulation, StarvationWatch
from poise.emulate.limits import Usage, is_starved
from poise.emulate.registry import InjectedFault, sweep

__all__ = [
    "EmulatedComputer",
    "EmulatedSet",
    "Emulation",
    "InjectedFault",
    "Probe",
    "StarvationWatch",
    "Usage",
    "all_sets",
    "background_load",
    "find_set",
    "full_speed",
    "is_starved",
    "probe_host",
    "set_for",
    "sweep",
]
