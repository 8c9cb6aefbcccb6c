"""Bags of ROS 2: folders that rosbag2 records, and their files (extra `ros2`)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msgspec import Struct

from poise.errors import UsageError, listed

_MCAP_OF_ROS = b"\x04\x00\x00\x00ros2"
"""The profile in the first bytes of an MCAP file that ROS 2 wrote."""
_BEGINNING = 64


class BagMessage(Struct, frozen=True):
    """A message as ROS 2 serialised it, and when it was recorded [s since 1970]."""

    topic: str
    at: float
    data: bytes


class Bag:
    """A bag of ROS 2; UsageError: it cannot be read.

    `types`: topic -> ``package/msg/Name``.
    `silent`: those of them of which it has no message.
    `seconds`: from the first message to the last.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._reader() as reader:
            self.types = {c.topic: str(c.msgtype) for c in reader.connections}
            heard = {c.topic for c in reader.connections if c.msgcount}
            self.silent = self.types.keys() - heard
            self.seconds = reader.duration / 1e9

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of some topics, oldest first."""
        if missing := set(topics) - self.types.keys():
            raise UsageError(
                f"bag {self.path} has no topic {listed(sorted(missing))}; it has "
                f"{listed(sorted(self.types))}"
            )
        with self._reader() as reader:
            wanted = [c for c in reader.connections if c.topic in topics]
            for connection, at, data in reader.messages(wanted):
                yield BagMessage(connection.topic, at / 1e9, bytes(data))

    @contextmanager
    def _reader(self) -> Iterator[Any]:
        try:
            from rosbags import rosbag2  # noqa: PLC0415, an extra
        except ImportError as error:
            raise UsageError(
                f"bag {self.path}: reading it needs rosbags: pip install 'poise[ros2]'"
            ) from error
        if self.path.is_dir() and not (self.path / "metadata.yaml").exists():
            raise UsageError(
                f"folder {self.path} is no bag: it has no metadata.yaml. If its "
                f"recorder was killed, `ros2 bag reindex {self.path}` writes it"
            )
        try:
            with rosbag2.Reader(self.path) as reader:
                yield reader
        except Exception as error:  # the library raises what its libraries raise
            is_known = isinstance(error, rosbag2.ReaderError | OSError)
            what = "cannot be read" if is_known else "is damaged"
            why = " ".join(str(error).split())  # some have several lines
            raise UsageError(f"bag {self.path} {what}: {why}") from error


def is_bag(path: Path) -> bool:
    """Return whether this is a bag, and no recording of Poise."""
    if path.suffix != ".mcap" or not path.is_file():
        return path.is_dir() or path.suffix == ".db3"
    with path.open("rb") as file:
        return _MCAP_OF_ROS in file.read(_BEGINNING)
