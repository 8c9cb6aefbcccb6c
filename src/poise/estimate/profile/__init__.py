"""Profiles: what a robot's software needed when it was measured."""

from poise.estimate.profile.records import (
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
