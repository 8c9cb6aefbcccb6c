"""What every window of every component goes through; the code is in ``native``."""

from typing import Literal

LEARN: int
"""Windows from which the noise is learned, and the reference when none is given."""
DISTURBANCE: int
"""What is over within so many windows is no shift, however much it was."""

class Shift:
    """Watches ``value / exposure``, such as CPU time per second or per job.

    Parameters
    ----------
    reference
        What it should be; None: learned from the first 150 windows, and used from the
        first `LEARN` on.
    """

    def __init__(self, reference: float | None = None) -> None: ...
    @property
    def reference(self) -> float | None:
        """What it should be, given or learned; None: not yet."""

    @property
    def since(self) -> int:
        """How many windows ago the shift began that was told last."""

    def update(self, value: float, exposure: float) -> Literal[-1, 0, 1]:
        """Take a window; return 1 or -1 when the rate has shifted up or down.

        After a shift the sums start again, with the same reference.

        Parameters
        ----------
        value
            What was counted in the window.
        exposure
            What it is counted per [s, or jobs]; >= 0.
        """
