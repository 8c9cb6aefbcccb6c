"""Detects changes of a rate; its header in ``native`` explains it."""

from typing import Literal

LEARN: int
"""Windows to learn the noise from, and the reference if none is given."""
OUTLIER: int
"""Deviations of up to this many windows are outliers, whatever their size."""

class ChangePointDetector:
    """Watches ``value / exposure``, such as CPU time per second or per job.

    Parameters
    ----------
    reference
        The expected rate. None: it is learned from the first 150 windows, and used
        after the first `LEARN`.
    """

    def __init__(self, reference: float | None = None) -> None: ...
    @property
    def reference(self) -> float | None: ...
    @property
    def since(self) -> int: ...
    def update(self, value: float, exposure: float) -> Literal[-1, 0, 1]: ...
