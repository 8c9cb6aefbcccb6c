"""Wheels are chosen once for each platform, and pinned by their hashes."""

from __future__ import annotations

import errno
import hashlib
import os
import sys
import zipfile
from pathlib import Path

import msgspec
import pytest

from poise.errors import RunError, UsageError
from poise.session.deploy import deploy
from poise.session.deploy.deploy import LOCK, files_for, lock_wheels, manifest_of
from poise.wire.records.code_records import Manifest
from tests.tiny_wheel import make_wheel

PLATFORMS = ("x86_64 3.11 2.36", "aarch64 3.12 2.31")


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of wheels, all that pip finds."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "requirements.txt").write_text("tiny\n")
    return tmp_path / "index"


def test_a_robot_without_requirements_has_no_wheels(tmp_path: Path) -> None:
    assert manifest_of(str(tmp_path)) == Manifest()
    assert lock_wheels(str(tmp_path), PLATFORMS) == Manifest()


@pytest.mark.exhaustive
@pytest.mark.slow
def test_wheels_are_for_the_platform_of_each_computer(
    tmp_path: Path, index: Path
) -> None:
    make_wheel(index, "1.0", "cp311-cp311-manylinux_2_28_x86_64")
    make_wheel(index, "1.0", "cp312-cp312-manylinux2014_aarch64")
    wheels = lock_wheels(str(tmp_path), PLATFORMS).wheels
    assert [*wheels[PLATFORMS[0]]] == ["tiny-1.0-cp311-cp311-manylinux_2_28_x86_64.whl"]
    assert [*wheels[PLATFORMS[1]]] == ["tiny-1.0-cp312-cp312-manylinux2014_aarch64.whl"]
    with pytest.raises(RunError, match=r"pip cannot fetch the wheels of .* for riscv"):
        lock_wheels(str(tmp_path), ["riscv64 3.11 2.36"])


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_lock_holds_until_the_requirements_change(
    tmp_path: Path, index: Path
) -> None:
    with pytest.raises(UsageError, match="run `poise deploy FILE`, which locks"):
        manifest_of(str(tmp_path))
    old = make_wheel(index, "1.0")
    manifest = lock_wheels(str(tmp_path), PLATFORMS[:1])
    make_wheel(index, "2.0")
    assert lock_wheels(str(tmp_path), PLATFORMS[:1]) == manifest
    assert manifest_of(str(tmp_path)) == manifest
    digest = hashlib.sha256(old.read_bytes()).hexdigest()
    assert manifest.wheels == {PLATFORMS[0]: {old.name: digest}}

    cached = files_for(manifest, PLATFORMS[0])[digest]
    cached.unlink()  # another developer has the lock alone
    assert files_for(manifest, PLATFORMS[0])[digest].read_bytes() == old.read_bytes()
    cached.write_bytes(b"PK")  # killed amid a copy, or the disk was full
    assert files_for(manifest, PLATFORMS[0])[digest].read_bytes() == old.read_bytes()
    cached.unlink()
    with zipfile.ZipFile(old, "a") as wheel:
        wheel.writestr("evil.py", "")
    with pytest.raises(RunError, match="DO NOT MATCH THE HASHES"):
        files_for(manifest, PLATFORMS[0])

    (tmp_path / "requirements.txt").write_text("tiny>1\n")
    with pytest.raises(UsageError, match="was written or changed since"):
        manifest_of(str(tmp_path))
    assert [*lock_wheels(str(tmp_path), PLATFORMS[:1]).wheels[PLATFORMS[0]]] == [
        "tiny-2.0-py3-none-any.whl"
    ]


def test_a_full_disk_leaves_the_lock_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fill(path: Path, *_: object, **__: object) -> int:
        path.open("w").close()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "requirements.txt").write_text("tiny\n")
    monkeypatch.setattr(deploy, "_fetch", lambda *_: {"tiny-1.0.whl": "f0"})
    manifest = lock_wheels(str(tmp_path), PLATFORMS[:1])
    for write in ("write_text", "write_bytes"):
        monkeypatch.setattr(Path, write, fill)
    with pytest.raises(RunError, match=r"requirements\.lock cannot be written: No sp"):
        lock_wheels(str(tmp_path), PLATFORMS)
    assert manifest_of(str(tmp_path)) == manifest
    assert {path.name for path in tmp_path.iterdir()} == {"requirements.txt", LOCK}


def test_a_damaged_lock_is_named(tmp_path: Path) -> None:
    (tmp_path / "requirements.txt").write_text("tiny\n")
    (tmp_path / LOCK).write_bytes(msgspec.json.encode([sys.maxsize]))
    with pytest.raises(UsageError, match=r"requirements.lock is damaged .*remove it"):
        manifest_of(str(tmp_path))
