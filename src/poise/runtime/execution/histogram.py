"""Many values in little space: counts in buckets that grow by a fixed factor.

The code is native, because every call counts its delay; ``tests/runtime/reference.py``
is the same in Python.
"""

from poise.runtime._calls import Histogram

__all__ = ["Histogram"]
