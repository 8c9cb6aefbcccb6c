"""Detects changes of a rate: cumulative sums with a threshold that fits the noise.

This is Page's CUSUM: deviations beyond a slack add up, and the sum never falls below
zero. By Wald's approximation a sum of independent steps with variance s2 and drift -k
passes h once in about ``exp(2 k h / s2)`` steps. So ``h = s2 * RARITY / (2 k)`` makes
false alarms equally rare for any noise. The more noise, the later a change is found.

Changes by less than a quarter of the reference are ignored. RARITY = 20 gives one false
alarm in exp(20) windows, years at 5 Hz, if the noise is normal. The threshold is never
lower than two windows' worth of the reference.

Real noise is not normal. Steady components have single windows with 10 ms more CPU time
than all others, and a machine may be slow for most of a second. So a change must last
for ten windows, and must remain without its worst `OUTLIER` consecutive windows: no
deviation shorter than a second is a change. No window counts for more than one and a
half times the largest learned one, one outlier excepted. A change by half is found
after 10 windows at the earliest.

The code is native, because each component has three detectors and each window passes
through all of them; ``tests/estimate/reference.py`` does the same in Python.
"""

from poise.estimate import _change_point

LEARN = _change_point.LEARN
"""Windows to learn the noise from, and the reference if none is given."""

OUTLIER = _change_point.OUTLIER
"""Deviations of up to this many windows are outliers, whatever their size."""

ChangePointDetector = _change_point.ChangePointDetector
