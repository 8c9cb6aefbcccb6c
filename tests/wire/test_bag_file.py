"""Bags of ROS 2 are read, of both storages, as a folder and as the file in it."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.wire.bag_file import Bag, is_bag
from tests.bags import BEGAN, PERIOD, write_bag
from tests.recordings import write_recording


@pytest.mark.parametrize(("storage", "file"), [("mcap", "mcap"), ("sqlite3", "db3")])
def test_reads_a_folder_and_the_file_in_it(
    tmp_path: Path, storage: str, file: str
) -> None:
    write_bag(tmp_path / "drive", 3, storage)
    for path in (tmp_path / "drive", tmp_path / "drive" / f"drive.{file}"):
        assert is_bag(path)
        bag = Bag(path)
        assert bag.types == {"/scan": "sensor_msgs/msg/LaserScan"}
        assert not bag.silent
        assert bag.seconds == pytest.approx(2 * PERIOD)
        messages = list(bag.messages(["/scan"]))
        assert [each.topic for each in messages] == ["/scan"] * 3
        expected = [BEGAN, BEGAN + PERIOD, BEGAN + 2 * PERIOD]
        assert [each.at for each in messages] == pytest.approx(expected, abs=1e-3)
        # what says how it is serialised, and a header and numbers
        assert {len(each.data) > 400 for each in messages} == {True}


@pytest.mark.parametrize(("storage", "file"), [("mcap", "mcap"), ("sqlite3", "db3")])
def test_knows_a_topic_without_a_message(
    tmp_path: Path, storage: str, file: str
) -> None:
    write_bag(tmp_path / "drive", 0, storage)
    for path in (tmp_path / "drive", tmp_path / "drive" / f"drive.{file}"):
        assert Bag(path).silent == {"/scan"}


def test_a_recording_of_poise_is_no_bag(tmp_path: Path) -> None:
    write_recording(tmp_path / "run.mcap", "robot")
    assert not is_bag(tmp_path / "run.mcap")
    assert not is_bag(tmp_path / "none.mcap")


def test_says_what_is_wrong_with_a_bag(tmp_path: Path) -> None:
    (tmp_path / "broken.db3").write_text("no database")
    with pytest.raises(UsageError, match=r"broken\.db3 cannot be read: Cannot open"):
        Bag(tmp_path / "broken.db3")
    with pytest.raises(UsageError, match=r"none\.db3 cannot be read.*does not exist"):
        Bag(tmp_path / "none.db3")
    write_bag(tmp_path / "drive", 1)
    with pytest.raises(UsageError, match=r"drive has no topic '/map'; it has '/scan'"):
        list(Bag(tmp_path / "drive").messages(["/map"]))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_damaged_bag_raises_nothing_but_what_is_documented(
    tmp_path: Path, storage: str
) -> None:
    write_bag(tmp_path / "drive", 50, storage)
    (file,) = (f for f in (tmp_path / "drive").iterdir() if f.suffix != ".yaml")
    whole = file.read_bytes()
    for at in range(0, len(whole), len(whole) // 12):
        file.write_bytes(whole[:at] + bytes([0xFF]) * 64 + whole[at + 64 :])
        # what hits numbers only goes unnoticed
        with contextlib.suppress(UsageError):
            list(Bag(tmp_path / "drive").messages(["/scan"]))


def test_damaged_metadata_is_said_in_one_line(tmp_path: Path) -> None:
    write_bag(tmp_path / "drive", 1)
    (tmp_path / "drive" / "metadata.yaml").write_bytes(b"foo: [\n")
    with pytest.raises(
        UsageError, match=r"drive cannot be read: .*metadata\.yaml"
    ) as e:
        Bag(tmp_path / "drive")
    assert "\n" not in str(e.value)
    (tmp_path / "drive" / "metadata.yaml").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match=r"drive is damaged: .*decode"):
        Bag(tmp_path / "drive")


def test_says_what_writes_metadata_that_are_missing(tmp_path: Path) -> None:
    write_bag(tmp_path / "drive", 1)
    (tmp_path / "drive" / "metadata.yaml").unlink()
    with pytest.raises(UsageError, match=r"no metadata\.yaml.*`ros2 bag reindex .*`"):
        Bag(tmp_path / "drive")
