"""The wheels install where there is no compiler, and a robot runs there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import LONG
from tests.wheels.arm64 import Arm64

pytestmark = [pytest.mark.slow, pytest.mark.wheels, pytest.mark.timeout(2400)]

ROOT = Path(__file__).parents[2]
COMPILER = re.compile(
    r"(.*-)?(cc|[gc]\+\+|gcc|clang(\+\+)?|c[89]9|cpp|ld(\..*)?|as|make|cmake|ninja)"
    r"(-[\d.]+)?"
)


def python_of(minor: int) -> str:
    """Return a Python of this version, or skip the test."""
    environment = dict(os.environ)
    if shutil.which("pyenv"):
        have = subprocess.run(
            ["pyenv", "versions", "--bare"], capture_output=True, text=True, check=True
        )
        environment["PYENV_VERSION"] = ":".join(have.stdout.split())
    found = (
        subprocess.run(
            [f"python3.{minor}", "-c", "import sys, ensurepip; print(sys.executable)"],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if shutil.which(f"python3.{minor}")
        else None
    )
    if found is None or found.returncode:
        pytest.skip(f"there is no Python 3.{minor} with venv")
    return found.stdout.strip()


def programs_without_compilers(folder: Path) -> Path:
    """Return a folder with all programs of this machine but those that compile."""
    folder.mkdir()
    for place in ("/usr/bin", "/usr/sbin", "/bin", "/sbin"):
        for program in Path(place).iterdir():
            link = folder / program.name
            if not COMPILER.fullmatch(program.name) and not link.is_symlink():
                link.symlink_to(program)
    return folder


TWO_MODULES = """
from poise.wire import _channel
from poise.runtime._calls import Exclusion
exclusion = Exclusion("eye")
exclusion.leave()
exclusion.leave()
"""
"""The second module raises; each has a C++ library of its own."""


@pytest.mark.parametrize("minor", [11, 12, 13, 14])
def test_a_robot_runs_where_there_is_no_compiler(
    minor: int, dist: Path, tmp_path: Path
) -> None:
    tag = "cp311-cp311" if minor == 11 else "cp312-abi3"
    (wheel,) = dist.glob(f"poise-*-{tag}-manylinux*_x86_64.whl")
    subprocess.run([python_of(minor), "-m", "venv", tmp_path / "env"], check=True)
    place = tmp_path / "env/bin"
    path = f"{place}:{programs_without_compilers(tmp_path / 'programs')}"
    assert [shutil.which(name, path=path) for name in ("cc", "g++", "cmake")] == [
        None
    ] * 3

    def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [place / words[0], *words[1:]],
            env={**os.environ, "PATH": path, "PYTHONPATH": ""},
            cwd=ROOT / "examples/hello",
            capture_output=True,
            text=True,
            timeout=LONG,
            check=False,
        )

    install = ("pip", "install", "--quiet", "--disable-pip-version-check")
    for what in (
        ("--only-binary", ":all:", "--require-hashes", "-r", dist / "dependencies.txt"),
        ("--no-deps", wheel),
        ("--no-index", wheel),  # its dependencies are all there
    ):
        installed = run(*install, *what)
        assert installed.returncode == 0, installed.stderr
    assert run("poise", "--version").stdout == f"poise {wheel.name.split('-')[1]}\n"
    assert run("poise", "check", "robot.yaml").returncode == 0
    raised = run("python", "-c", TWO_MODULES).stderr.splitlines()[-1]
    assert raised == "RuntimeError: nobody is inside"
    hello = run("poise", "run", "robot.yaml", "--task", "greet", "--for", "3s")
    assert "printer has 20" in hello.stderr, hello.stdout + hello.stderr


INSTALL = """
mount -t tmpfs none "$0"
cd "$0"
mkdir above work root
mount -t overlay -o lowerdir=/,upperdir=above,workdir=work overlay root
mount -t proc proc root/proc
mount --rbind /dev root/dev
mount -t tmpfs none root/tmp
cp -r "$@" root/tmp
chroot root sh -ec '
  cd /tmp/hello
  dpkg --install ../poise_*.deb
  poise run robot.yaml --task greet --for 3s
  poise agent install left --robot hello --address 127.0.0.1 --unit-folder .
  grep ExecStart *.service
  dpkg --purge poise
  ! ls /usr/bin/poise /opt/poise 2>/dev/null
'
"""
"""Installs, uses and removes a package; nothing of it stays on this machine."""
INSIDE = "unshare", "-m", "sh", "-ec"


def test_the_package_of_debian_installs_and_leaves_nothing(
    dist: Path, tmp_path: Path
) -> None:
    if os.getuid() or not Path("/usr/share/doc/python3.11-venv").exists():
        pytest.skip("this is no Debian 12 with python3-venv, or this user is not root")
    subprocess.run([sys.executable, ROOT / ".ci/deb.py"], check=True)
    (package,) = dist.glob("poise_*.deb")
    done = subprocess.run(
        [*INSIDE, INSTALL, tmp_path, package, ROOT / "examples/hello"],
        env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/tmp"},
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "printer has 20" in done.stderr
    assert "ExecStart=/opt/poise/bin/python3 -m poise agent left" in done.stdout


def test_the_same_commit_gives_the_same_files_at_another_time_and_place(
    dist: Path, tmp_path: Path
) -> None:
    git = ["git", "-C", str(ROOT)]
    changed = subprocess.run(
        [*git, "status", "--porcelain"], capture_output=True, text=True, check=False
    )
    if changed.returncode or changed.stdout:
        pytest.skip(f"what is here is no commit: {changed.stdout}{changed.stderr}")
    clone = tmp_path / "elsewhere"
    subprocess.run([*git, "clone", "--quiet", ROOT, clone], check=True)
    (clone / "build/wheels").mkdir(parents=True)
    for tools in ("tools", "cp311", "zig-cache"):
        (clone / "build/wheels" / tools).symlink_to(ROOT / "build/wheels" / tools)
    script = [sys.executable, str(clone / ".ci/wheels.py"), "cp311-x86_64"]
    subprocess.run(script, umask=0o077, timeout=1800, check=True)
    again = {file.name: file.read_bytes() for file in (clone / "dist").iterdir()}
    assert sorted(Path(name).suffix for name in again) == [
        *(".gz", ".json", ".txt", ".whl")
    ]
    differ = [n for n, data in again.items() if (dist / n).read_bytes() != data]
    assert differ == []


def test_a_robot_runs_and_moves_on_aarch64(
    dist: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (wheel,) = dist.glob("poise-*-cp311-cp311-manylinux*_aarch64.whl")
    tmp_path = tmp_path_factory.mktemp("a")  # sockets need a short path
    arm64 = Arm64(tmp_path / "arm64")
    arm64.install(Path(sys.executable), dist / "dependencies.txt", wheel)
    hello = tmp_path / "hello"
    shutil.copytree(ROOT / "examples/hello", hello)
    try:
        words = ("poise", "up", "robot.yaml", "--task", "greet", "--detach")
        assert "robot 'hello' is up" in arm64.run(*words, cwd=hello)
        said = arm64.run("poise", "move", "printer", "left", cwd=hello)
        assert "printer runs on left now" in said
        arm64.run("poise", "stop", cwd=hello)
    finally:
        arm64.run("poise", "emulate", "stop", cwd=hello)
