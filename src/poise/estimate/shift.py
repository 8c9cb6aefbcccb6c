"""Finds that a rate has shifted: cumulative sums with a threshold that fits the noise.

Page's CUSUM: what exceeds the reference by more than a slack adds up; the sum starts
again at zero whenever it would be negative. By Wald's approximation a sum of
independent steps with variance s2 and drift -k passes h once in about
``exp(2 k h / s2)`` steps, so that ``h = s2 * RARITY / (2 k)`` sets how rare false
alarms are, whatever the noise. The price is honest: the noisier, the later a shift is
found.

Shifts by less than a quarter of the reference are no shifts. With RARITY = 20 a false
alarm comes about once in exp(20) windows: years, at 5 Hz, by a theory that takes noise
for normal. The threshold is never lower than two windows' worth of the reference,
however calm it was.

Real noise is not normal: recordings of steady components have single windows with 10 ms
more CPU time than all others, and a machine may be slow for most of a second. So a
shift must have lasted for ten windows, and stand without the worst `DISTURBANCE` of
them that follow each other: whatever is over within a second is none, however large it
is. And no window counts for more than one and a half times the largest that was learned
from, but for one disturbance there. A shift by half is found after 10 windows at the
earliest.

The code is native, because every window of every component goes through three of these;
``tests/estimate/reference.py`` is the same in Python.
"""

from poise.estimate import _shift

LEARN = _shift.LEARN
"""Windows from which the noise is learned, and the reference when none is given."""

DISTURBANCE = _shift.DISTURBANCE
"""What is over within so many windows is no shift, however much it was."""

Shift = _shift.Shift
