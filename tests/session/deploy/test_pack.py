"""The same code gives the same archive, wherever and whenever it is packed."""

from __future__ import annotations

import io
import os
import shutil
import tarfile
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.model import load
from poise.model.robot import Robot
from poise.session.deploy.deploy import pack, version_of
from poise.wire.records.code_records import Manifest

NONE = Manifest()
FILE = """
robot: packed
computers:
  left: {cpu: 1, memory: 1 GiB}
repository: [shared]
architectures:
  work:
    function: work
    components:
      eye: {implementation: "eyes.left:Eye", cpu: 1%, memory: 20 MiB}
      script: {command: ["bin/run.sh", "notes.txt"], cpu: 1%, memory: 20 MiB}
"""


def write(folder: Path) -> Robot:
    for name, text in {
        "robot.yaml": FILE,
        "unused.py": "",
        "eyes/__init__.py": "",
        "eyes/left.py": "import lens\nclass Eye: ...\n",
        "eyes/data/map.txt": "map",
        "eyes/__pycache__/left.cpython-311.pyc": "old",
        "eyes/.hidden": "",
        "shared/lens.py": "import glass",
        "shared/glass.py": "",
        "bin/run.sh": "#!/bin/sh\n",
        "notes.txt": "notes",
    }.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (folder / "bin/run.sh").chmod(0o755)
    return load(folder / "robot.yaml")


def names_in(archive: bytes) -> dict[str, tarfile.TarInfo]:
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        return {member.name: member for member in tar}


def test_packs_what_components_import_and_run(tmp_path: Path) -> None:
    members = names_in(pack(write(tmp_path), NONE))
    assert sorted(members) == [
        "code/bin/run.sh",
        "code/eyes/__init__.py",
        "code/eyes/data/map.txt",
        "code/eyes/left.py",
        "code/glass.py",
        "code/lens.py",
        "code/notes.txt",
        "manifest.json",
    ]
    assert members["code/bin/run.sh"].mode == 0o755
    assert members["code/lens.py"].mode == 0o644


def test_packs_modules_and_packages_that_are_links(tmp_path: Path) -> None:
    robot = write(tmp_path / "robot")
    whole = pack(robot, NONE)
    for name in ("eyes", "shared/glass.py"):
        kept = tmp_path / "elsewhere" / name
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(tmp_path / "robot" / name, kept)
        (tmp_path / "robot" / name).symlink_to(kept)
    assert pack(robot, NONE) == whole


def test_packs_no_installed_program_nor_what_lies_elsewhere(tmp_path: Path) -> None:
    robot = write(tmp_path / "robot")
    (tmp_path / "robot/bin/shell").symlink_to("/bin/sh")
    (tmp_path / "beside.py").touch()
    (architecture,) = robot.architectures
    eye, script = architecture.components
    for word in ("bin/shell", "/bin/sh", "../beside.py"):
        other = replace(script, command=("bin/run.sh", word))
        changed = replace(architecture, components=(eye, other))
        members = names_in(pack(replace(robot, architectures=(changed,)), NONE))
        assert "code/bin/run.sh" in members
        assert not {"code/bin/shell", "code/beside.py"} & members.keys()


def test_packs_the_same_bytes_at_another_time_and_place(tmp_path: Path) -> None:
    first = pack(write(tmp_path / "one"), NONE)
    umask = os.umask(0o077)
    try:
        robot = write(tmp_path / "two")
    finally:
        os.umask(umask)
    for path in (tmp_path / "two").rglob("*"):
        os.utime(path, (1, 1))
    assert pack(robot, NONE) == first


def test_other_code_or_wheels_are_another_version(tmp_path: Path) -> None:
    robot = write(tmp_path)
    versions = {version_of(pack(robot, NONE))}
    versions.add(version_of(pack(robot, Manifest(wheels={"x86_64": {"a": "b"}}))))
    (tmp_path / "shared/glass.py").write_text("x = 1")
    versions.add(version_of(pack(robot, NONE)))
    (tmp_path / "unused.py").write_text("x = 1")
    versions.add(version_of(pack(robot, NONE)))
    assert len(versions) == 3


def test_says_when_there_is_no_code(tmp_path: Path) -> None:
    robot = write(tmp_path)
    for name in ("eyes", "bin", "notes.txt"):
        path = tmp_path / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(UsageError, match="there is no code of robot 'packed' in"):
        pack(replace(robot, repository=()), NONE)
