"""The wheels of a robot's `requirements.txt`, for each platform of its computers.

They are chosen once, and written with their hashes into `requirements.lock` beside it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import msgspec

from poise.errors import RunError, UsageError
from poise.wire.codec import MALFORMED
from poise.wire.records.code_records import Manifest

REQUIREMENTS, LOCK = "requirements.txt", "requirements.lock"
_LIMIT = 600.0
"""pip fetches the wheels of one platform within this time [s]."""
_OLDEST = 17
"""The C library (2.17) that the oldest wheels still in use were built for."""


class _Lock(msgspec.Struct, frozen=True, kw_only=True):
    requirements: str  # The SHA-256 of `REQUIREMENTS` that it is for
    wheels: Mapping[str, Mapping[str, str]]  # As in `Manifest`


def manifest_of(folder: str) -> Manifest:
    """Return the wheels that are locked for a robot; UsageError: they are not."""
    requirements = Path(folder, REQUIREMENTS)
    if not requirements.exists():
        return Manifest()
    wheels = _locked(requirements)
    if not wheels:
        raise UsageError(
            f"{requirements} was written or changed since {LOCK}: run `poise deploy "
            "FILE`, which locks its wheels"
        )
    return Manifest(wheels=wheels)


def lock_wheels(folder: str, platforms: Collection[str]) -> Manifest:
    """Choose wheels for platforms that have none; return all that is locked."""
    requirements = Path(folder, REQUIREMENTS)
    if not requirements.exists():
        return Manifest()
    wheels = dict(_locked(requirements))
    new = sorted(set(platforms) - wheels.keys())
    for platform in new:
        wheels[platform] = _fetch(requirements, platform)
    if new:
        lock = _Lock(requirements=_digest(requirements), wheels=wheels)
        text = msgspec.json.format(msgspec.json.encode(lock, order="deterministic"))
        requirements.with_name(LOCK).write_bytes(text + b"\n")
    return Manifest(wheels=wheels)


def files_for(manifest: Manifest, platform: str) -> dict[str, Path]:
    """Return the wheels for a platform by their SHA-256, fetched again if need be."""
    wheels = manifest.wheels.get(platform, {})
    if not all(map(_is_cached, wheels.values())):
        with tempfile.TemporaryDirectory() as folder:
            pinned = Path(folder, REQUIREMENTS)
            pinned.write_text("\n".join(_pins(wheels)))
            _fetch(pinned, platform, "--no-deps", "--require-hashes")
    return {digest: _cached(digest) for digest in wheels.values()}


def _pins(wheels: Mapping[str, str]) -> Iterator[str]:
    for wheel, digest in wheels.items():
        name, version, *_ = wheel.split("-")
        yield f"{name}=={version} --hash=sha256:{digest}"


def _locked(requirements: Path) -> Mapping[str, Mapping[str, str]]:
    """Return the wheels of the lock; none: it is missing, or for other requirements."""
    path = requirements.with_name(LOCK)
    if not path.exists():
        return {}
    try:
        lock = msgspec.json.decode(path.read_bytes(), type=_Lock)
    except MALFORMED as error:
        raise UsageError(f"{path} is damaged ({error}): remove it") from error
    return lock.wheels if lock.requirements == _digest(requirements) else {}


def _fetch(requirements: Path, platform: str, *options: str) -> dict[str, str]:
    """Fetch wheels into the cache; return the SHA-256 of each, by its name."""
    with tempfile.TemporaryDirectory() as folder:
        argv = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input"]
        argv += ["--disable-pip-version-check", "--only-binary", ":all:", *options]
        argv += [*_target(platform), "--dest", folder, "-r", str(requirements)]
        try:
            done = subprocess.run(  # noqa: S603, our own Python
                argv, capture_output=True, timeout=_LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            raise RunError(
                f"pip did not fetch the wheels for {platform} within {_LIMIT:g} s"
            ) from None
        if done.returncode:
            raise RunError(
                f"pip cannot fetch the wheels of {requirements} for {platform}: "
                f"{done.stderr.decode(errors='replace').strip()}"
            )
        wheels = {path.name: _digest(path) for path in sorted(Path(folder).iterdir())}
        for name, digest in wheels.items():
            _cached(digest).parent.mkdir(parents=True, exist_ok=True)
            shutil.move(Path(folder, name), _cached(digest))
    return wheels


def _target(platform: str) -> list[str]:
    """Return pip's options for a platform, as in `AgentStatus`."""
    machine, python, *library = platform.split()
    names = [f"linux_{machine}", f"manylinux2014_{machine}"]
    if library:
        newest = int(library[0].split(".")[1])
        names += [
            f"manylinux_2_{minor}_{machine}" for minor in range(newest, _OLDEST - 1, -1)
        ]
    options = ["--python-version", python, "--implementation", "cp"]
    return [*options, *(word for name in names for word in ("--platform", name))]


def _cached(digest: str) -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache, "poise", "wheels", f"{digest}.whl")


def _is_cached(digest: str) -> bool:
    """Return whether a wheel is there, and whole: a copy may have been cut short."""
    path = _cached(digest)
    return path.exists() and _digest(path) == digest


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
