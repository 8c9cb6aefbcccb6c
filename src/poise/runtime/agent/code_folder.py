"""The versions of a robot's code on its computer, which are whole or not there.

Files come in parts. An archive is unpacked beside the versions, written to the disk,
and renamed as the last step, so that an agent that is killed leaves nothing half done.
"""

from __future__ import annotations

import contextlib
import hashlib
import lzma
import os
import platform
import re
import shutil
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path, PurePosixPath
from threading import Lock
from typing import IO

from poise import threads
from poise.decoding import from_json
from poise.errors import RunError
from poise.runtime.agent.surroundings import Reply
from poise.runtime.container.account import Account
from poise.units import format_bytes
from poise.wire.codec import MALFORMED
from poise.wire.records.code_records import (
    MANIFEST,
    MOST_CODE,
    PACKAGES,
    SHOWN,
    CodePart,
    CodeReceived,
    InstallCode,
    Manifest,
)
from poise.wire.records.request_records import Accepted, Answer, Refused

KEPT = 3
"""The last versions stay, whether or not they run."""
_LATER = 1_000_000_000
"""Times of files differ by so much on any file system that code is kept on [ns]."""
_DIGEST = re.compile(r"[0-9a-f]{64}")
_BUFFER = 1 << 20
_NO_WHEEL = (
    *(zipfile.BadZipFile, NotImplementedError, EOFError, ValueError),
    *(RuntimeError, zlib.error, lzma.LZMAError),  # encrypted; damaged
)
"""What `zipfile` raises for damaged files."""


class CodeFolder:
    """Stores what is sent, one request at a time, on threads of its own."""

    def __init__(self, folder: Path, account: Account | None = None) -> None:
        self._folder = folder
        self._account = account  # it runs the code, but does not own it
        self._one_at_a_time = Lock()
        self._in_use: frozenset[str] = frozenset()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._remove_files()  # that a killed agent left
        self._versions = self._look()
        if account is not None:
            account.let_read(folder)
            account.check_reads(folder)

    def versions(self) -> tuple[str, ...]:
        """Return what is there, the last one first. No disk is used."""
        return self._versions

    def keep(self, in_use: Collection[str]) -> None:
        """Remove no version that is to run from now on."""
        self._in_use = frozenset(in_use)

    def serve(self, request: CodePart | InstallCode, reply: Reply) -> None:
        """Store or unpack; answers when that is done."""
        if not self._one_at_a_time.acquire(blocking=False):
            reply(Refused("it is still busy with other code: try again in a minute"))
            return
        try:
            threads.daemon(self._work, "code", request, reply).start()
        except RuntimeError as error:  # other threads may end
            self._one_at_a_time.release()
            reply(Refused(f"it cannot take code for now: {error}"))

    def _work(self, request: CodePart | InstallCode, reply: Reply) -> None:
        try:
            answer = self._done(request)
        finally:
            self._one_at_a_time.release()
        reply(answer)

    def _done(self, request: CodePart | InstallCode) -> Answer:
        try:
            if isinstance(request, CodePart):
                return self._store(request)
            self._install(request.version)
        except OSError as error:
            with contextlib.suppress(OSError):  # what is sent next may need the room
                self._remove_files()
            free = format_bytes(shutil.disk_usage(self._folder).free)
            return Refused(
                f"it cannot store the code: {error.strerror or error} ({free} are free "
                f"in {self._folder} without it): make room there, or start the agent "
                "with `--folder` on another disk"
            )
        except RunError as error:
            return Refused(str(error))
        return Accepted()

    def _store(self, part: CodePart) -> Answer:
        """Store a part; whatever goes wrong, nothing wrong stays."""
        whole, path = self._whole(part.file), self._folder / f"{part.file}.part"
        if whole.exists():
            return CodeReceived(part.size)
        others = (f for f in self._folder.glob("*.*") if f.is_file() and f != path)
        if part.size + sum(f.stat().st_size for f in others) > MOST_CODE:
            raise RunError(
                f"over {format_bytes(MOST_CODE)} of code at once are not stored"
            )
        held = path.stat().st_size if path.exists() else 0
        try:
            if part.offset == held:
                with path.open("ab") as file:
                    file.write(part.data)
                held += len(part.data)
            if held >= part.size:
                _check(path, part)
                path.replace(whole)
        except RunError:
            path.unlink(missing_ok=True)
            raise
        return CodeReceived(held)

    def _install(self, version: str) -> None:
        archive, new = self._whole(version), self._folder / f"{version}.new"
        if version in self._versions:
            self._make_last(version)
            return
        if not archive.exists():
            raise RunError(f"version {version[:SHOWN]} was not sent")
        try:
            new.mkdir()
            left = unpack(archive, new)
            for wheel in self._wheels(new / MANIFEST):
                left = unpack_wheel(wheel, new / PACKAGES, left)
            if self._account is not None:
                self._account.let_read(new)
            os.sync()
            new.rename(self._folder / version)
            _write_through(self._folder)
        except BaseException:  # nothing half done stays, whatever ends it
            shutil.rmtree(new, ignore_errors=True)
            raise
        self._make_last(version)
        self._remove_old()
        self._remove_files()

    def _make_last(self, version: str) -> None:
        """Let a version stay longest, also when the clock was set back."""
        last = (self._folder / self._look()[0]).stat().st_mtime_ns
        os.utime(self._folder / version, ns=(last + _LATER,) * 2)
        self._versions = self._look()

    def _wheels(self, manifest: Path) -> list[Path]:
        """Return the wheels for this computer; RunError: some were not sent."""
        try:
            wheels = from_json(manifest.read_bytes(), Manifest).wheels
        except (FileNotFoundError, *MALFORMED) as error:
            raise RunError(f"this is not the code of a robot: {error}") from error
        if wheels and this_platform() not in wheels:
            raise RunError(
                f"there are no wheels for {this_platform()}, only for "
                f"{', '.join(wheels)}: remove requirements.lock, and deploy again"
            )
        paths = {n: self._whole(d) for n, d in wheels.get(this_platform(), {}).items()}
        if missing := [name for name, path in paths.items() if not path.exists()]:
            raise RunError(f"wheels were not sent: {', '.join(missing)}")
        return list(paths.values())

    def _whole(self, digest: str) -> Path:
        if not _DIGEST.fullmatch(digest):
            raise RunError(f"{digest!r} is no SHA-256")
        return self._folder / f"{digest}.whole"

    def _look(self) -> tuple[str, ...]:
        found = [f for f in self._folder.iterdir() if _DIGEST.fullmatch(f.name)]
        found.sort(key=lambda folder: -folder.stat().st_mtime_ns)
        return tuple(folder.name for folder in found)

    def _remove_old(self) -> None:
        for version in self._versions[KEPT:]:
            if version not in self._in_use:
                shutil.rmtree(self._folder / version, ignore_errors=True)
        self._versions = self._look()

    def _remove_files(self) -> None:
        for path in self._folder.glob("*.*"):
            if path.is_file():
                path.unlink()
            else:
                shutil.rmtree(path, ignore_errors=True)


def this_platform() -> str:
    """Return this computer's machine, Python and C library, which wheels depend on."""
    _, library = platform.libc_ver()
    python = ".".join(map(str, sys.version_info[:2]))
    return f"{platform.machine()} {python} {library}".strip()


def unpack(archive: Path, into: Path, left: int = MOST_CODE) -> int:
    """Unpack plain files, and RunError for others; return how much is left [bytes]."""
    try:
        with tarfile.open(archive, "r:") as tar:
            for member in tar:
                content = tar.extractfile(member) if member.isreg() else None
                if content is None:
                    raise RunError(
                        f"{member.name!r} in the archive is not a plain file"
                    )
                is_program = bool(member.mode & 0o100)
                place = _place(into, member.name)
                left = _write(place, content, left, is_program=is_program)
    except (tarfile.TarError, ValueError) as error:  # a number that is none
        raise RunError(f"this is not an archive of code: {error}") from error
    return left


def unpack_wheel(wheel: Path, into: Path, left: int) -> int:
    """Unpack a wheel as `unpack` does; its scripts and headers are left out."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            for member in archive.infolist():
                name = _name_in_wheel(member.filename)
                if name and not member.is_dir():
                    place = _place(into, name)
                    place.unlink(missing_ok=True)  # of two wheels the last one counts
                    with archive.open(member) as content:
                        left = _write(place, content, left)
    except _NO_WHEEL as error:
        raise RunError(f"{wheel.name} is not a valid wheel: {error}") from error
    return left


def _name_in_wheel(name: str) -> str:
    """Return where a wheel's file goes among packages; empty: nowhere."""
    first, _, rest = name.partition("/")
    if not first.endswith(".data"):
        return name
    kind, _, rest = rest.partition("/")
    return rest if kind in {"purelib", "platlib"} else ""


def _place(into: Path, name: str) -> Path:
    path = PurePosixPath(name)
    is_odd = "\\" in name or "\0" in name
    if path.is_absolute() or ".." in path.parts or is_odd or not path.parts:
        raise RunError(f"{name!r} in the archive leads out of its folder")
    return into / path


def _write(
    place: Path, content: IO[bytes], left: int, *, is_program: bool = False
) -> int:
    """Write a new file of `left` bytes at most; return how many are left then."""
    place.parent.mkdir(parents=True, exist_ok=True)
    mode = 0o700 if is_program else 0o600
    with os.fdopen(
        os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb"
    ) as file:
        while data := content.read(_BUFFER):
            left -= len(data)
            if left < 0:
                raise RunError(f"over {format_bytes(MOST_CODE)} of code are not stored")
            file.write(data)
    return left


def _check(path: Path, part: CodePart) -> None:
    """Raise RunError when a file is not what was announced."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if (digest, path.stat().st_size) != (part.file, part.size):
        raise RunError(f"the file is not {part.file[:SHOWN]}: send it again")


def _write_through(folder: Path) -> None:
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
