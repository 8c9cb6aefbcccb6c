"""Writes bags of ROS 2, by rosbags, which needs no ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

PERIOD = 0.05
"""Of the messages in a bag [s]."""
BEGAN = 1_700_000_000
"""When the first was recorded [s since 1970]."""
AGE = 0.02
"""Of each when it was recorded [s]."""


def write_bag(
    path: Path,
    count: int,
    storage: str = "mcap",
    kind: str = "sensor_msgs/msg/LaserScan",
) -> None:
    """Write scans of 100 ranges, all of which are the number of the scan."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    import numpy as np  # noqa: PLC0415, only bags need it

    store = typesys.get_typestore(typesys.Stores.ROS2_KILTED)
    plugin = rosbag2.StoragePlugin[storage.upper()]
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as bag:
        end = bag.add_connection("/scan", kind, typestore=store)
        for number in range(count):
            at = int((BEGAN + number * PERIOD) * 1e9)
            message = _scan(store.types, at - int(AGE * 1e9), np.full(100, number))
            bag.write(end, at, store.serialize_cdr(message, kind))


def _scan(types: Any, stamp: int, ranges: Any) -> Any:
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    header = types["std_msgs/msg/Header"](time, "laser")
    ranges = ranges.astype("f4")
    scan = types["sensor_msgs/msg/LaserScan"]
    return scan(header, *[0.0] * 6, 8.0, ranges, ranges[:0])
