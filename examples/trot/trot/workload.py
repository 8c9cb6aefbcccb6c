"""Messages that come too seldom for a measurement to wait for (`poise profile`)."""

from __future__ import annotations

import random

from trot.messages import Order, Wish


def order(chance: random.Random, _: float) -> Order:
    """Return an order to put the cup on one side."""
    return Order(0.0, chance.choice(["left", "right"]))


def wish(_: random.Random, __: float) -> Wish:
    """Return a wish to see what is on television."""
    return Wish(0.0)
