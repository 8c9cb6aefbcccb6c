"""Poise keeps a robot's software in balance over its on-board computers."""

from poise.clock import Stamp
from poise.runtime.component import Component
from poise.runtime.ports import (
    Message,
    Provided,
    Published,
    Required,
    every,
    oneway,
    subscribed,
)
from poise.wire.loans import loan

__all__ = [
    "Component",
    "Message",
    "Provided",
    "Published",
    "Required",
    "Stamp",
    "every",
    "loan",
    "oneway",
    "subscribed",
]
