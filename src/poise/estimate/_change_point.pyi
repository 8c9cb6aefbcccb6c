"""Detects changes of a rate; native/change_point.h explains the method."""

from typing import Literal

LEARN: int = 25

OUTLIER: int = 5

class ChangePointDetector:
    """
    Watches ``value / exposure``, such as CPU time per second or per job.

    Parameters
    ----------
    reference
        The expected rate. None: it is learned from the first 150 windows, and used
        after the first `LEARN`.
    """

    def __init__(self, reference: float | None = None) -> None: ...
    def update(self, value: float, exposure: float) -> Literal[-1, 0, 1]:
        """
        Add a window; return 1 or -1 when the rate has risen or fallen, else 0.
        """

    @property
    def reference(self) -> float | None:
        """The expected rate; None until it is learned."""

    @property
    def since(self) -> int:
        """How many windows ago the last change began."""
