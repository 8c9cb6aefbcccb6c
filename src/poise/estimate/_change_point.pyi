"""Detects changes of a rate; the code is in ``native``."""

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
    def reference(self) -> float | None:
        """The expected rate, given or learned; None: not known yet."""

    @property
    def since(self) -> int:
        """How many windows ago the last change began."""

    def update(self, value: float, exposure: float) -> Literal[-1, 0, 1]:
        """Add a window; return 1 or -1 when the rate has risen or fallen, else 0.

        After a change the sums start again at zero, with the same reference.

        Parameters
        ----------
        value
            What was counted in the window.
        exposure
            What it is counted per [s, or jobs]; >= 0.
        """
