"""Profiles: what a robot's software needed when it was measured."""

from poise.estimate.profile.profile_records import (
    ComponentProfile,
    ConnectorProfile,
    Costs,
    KindCosts,
    Profile,
    TimerProfile,
)

__all__ = [
    "ComponentProfile",
    "ConnectorProfile",
    "Costs",
    "KindCosts",
    "Profile",
    "TimerProfile",
]
