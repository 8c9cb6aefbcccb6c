"""Packs a robot's code: the same code gives the same bytes, and so the same version."""

from __future__ import annotations

import hashlib
import io
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec

from poise.errors import UsageError
from poise.estimate.code_version import files_of, files_of_modules
from poise.model.robot import Robot
from poise.wire.records.code_records import CODE, MANIFEST, Manifest


def version_of(archive: bytes) -> str:
    """Return an archive's version: its SHA-256, in hexadecimal digits."""
    return hashlib.sha256(archive).hexdigest()


def pack(robot: Robot, manifest: Manifest) -> bytes:
    """Return the archive of the code of a robot's components and policies.

    It is what they import from the folders of the robot file and of its `repository`:
    modules, and packages with all files in them. Of commands, it is the program and
    the arguments that are files there.

    Raises UsageError when nothing of it is there.
    """
    files = _files(robot)
    if not files:
        raise UsageError(
            f"there is no code of robot '{robot.name}' in "
            f"{', '.join(robot.folders)}: what is installed on each computer needs no "
            "deployment"
        )
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as tar:
        _add(tar, MANIFEST, msgspec.json.encode(manifest, order="deterministic"))
        for name, path in sorted(files.items()):
            is_program = bool(path.stat().st_mode & 0o100)
            _add(tar, f"{CODE}/{name}", path.read_bytes(), is_program=is_program)
    return packed.getvalue()


def _files(robot: Robot) -> Mapping[str, Path]:
    """Return what is packed, by its name; of two, the first folder's counts."""
    folders = [Path(folder) for folder in robot.folders]
    calls = [p.call.partition(":")[0] for p in robot.policies if p.call]
    reached = files_of_modules(calls, folders)
    for component in robot.components():
        reached |= files_of(component, robot.folders)
    files: dict[str, Path] = {}
    for number, path in sorted(reached):
        folder = folders[number]
        if not path.resolve().is_relative_to(folder.resolve()):
            continue  # an installed program, say
        for file in _with_package(path, folder):
            files.setdefault(str(file.relative_to(folder)), file)
    return files


def _with_package(file: Path, folder: Path) -> Iterator[Path]:
    """Yield a file, or all files of the package that it is in."""
    top = folder / file.relative_to(folder).parts[0]
    if not (top / "__init__.py").exists():
        yield file
        return
    for path in top.rglob("*"):
        parts = path.relative_to(folder).parts
        is_hidden = any(part.startswith(".") or part == "__pycache__" for part in parts)
        if path.is_file() and not is_hidden and path.suffix != ".pyc":
            yield path


def _add(
    tar: tarfile.TarFile, name: str, content: bytes, *, is_program: bool = False
) -> None:
    """Add a file whose owner, time and other rights are always the same."""
    member = tarfile.TarInfo(name)
    member.size = len(content)
    member.mode = 0o755 if is_program else 0o644
    tar.addfile(member, io.BytesIO(content))
