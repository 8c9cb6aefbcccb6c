"""A Python for aarch64 on this machine: Debian's packages, run by qemu-user."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

QEMU = shutil.which("qemu-aarch64-static")
BINFMT = Path("/proc/sys/fs/binfmt_misc")
# a program of 64 bits for aarch64 (`binfmt_misc` of the kernel's documents); F: qemu is
# found in other namespaces, too
_FORMAT = (
    rb":qemu-aarch64:M::\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00"
    rb"\xb7\x00:\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe"
    rb"\xff\xff\xff:%s:F"
)
_PACKAGES = """
    libbz2-1.0 libc6 libcrypt1 libdb5.3 libexpat1 libffi8 libgcc-s1 liblzma5
    libncursesw6 libnsl2 libpython3.11-minimal libpython3.11-stdlib libreadline8
    libsqlite3-0 libssl3 libstdc++6 libtinfo6 libtirpc3 libuuid1
    python3.11 python3.11-minimal zlib1g
"""
_LIMIT = 600.0


class Arm64:
    """A Python 3.11 for aarch64 in a folder, with packages of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._root, self._site = folder / "root", folder / "site"
        _let_kernel_start_qemu()
        self._get_python()

    def install(self, python: Path, requirements: Path, wheel: Path) -> None:
        """Install a wheel and what it needs, by the pip of another Python."""
        tags = ("2014", "_2_17", "_2_28", "_2_31", "_2_34")
        platforms = [f"--platform=manylinux{tag}_aarch64" for tag in tags]
        argv: list[str | Path] = [python, "-m", "pip", "install"]
        argv += ["--quiet", "--no-deps"]
        argv += ["--target", self._site, "--python-version=3.11", "--only-binary=:all:"]
        argv += platforms
        _run([*argv, "--require-hashes", "-r", requirements])
        _run([*argv, wheel])

    def run(self, *words: str, cwd: Path) -> str:
        """Run ``python -m WORDS``; return what it prints."""
        homes = dict.fromkeys(
            ("HOME", "TMPDIR", "XDG_RUNTIME_DIR", "XDG_STATE_HOME"), str(self._folder)
        )
        environment = {
            **os.environ,
            **homes,
            "QEMU_LD_PREFIX": str(self._root),
            "PYTHONPATH": str(self._site),
        }
        argv: list[str | Path] = [self._root / "usr/bin/python3.11", "-m", *words]
        return _run(argv, cwd=cwd, env=environment)

    def _get_python(self) -> None:
        apt = ["apt-get", "-qq", "-o", "APT::Sandbox::User=root"]
        for option in ("APT::Architecture=arm64", "APT::Architectures::=arm64"):
            apt += ["-o", option]
        for name in ("state/lists/partial", "cache/archives/partial", "packages"):
            (self._folder / name).mkdir(parents=True)
        apt += ["-o", f"Dir::State={self._folder}/state"]
        apt += ["-o", "Dir::State::status=/dev/null"]
        apt += ["-o", f"Dir::Cache={self._folder}/cache"]
        try:
            _run([*apt, "update"])
            _run([*apt, "download", *_PACKAGES.split()], cwd=self._folder / "packages")
        except AssertionError as error:
            pytest.skip(f"no packages for arm64: {error}")
        for package in (self._folder / "packages").iterdir():
            _run(["dpkg", "-x", package, self._root])


def _let_kernel_start_qemu() -> None:
    """Let the kernel run programs for aarch64 by qemu, or skip the test."""
    if os.getuid() or not QEMU or not shutil.which("apt-get"):
        pytest.skip("qemu-aarch64-static and apt-get are needed, and root")
    try:
        if not (BINFMT / "register").exists():
            _run(["mount", "-t", "binfmt_misc", "none", BINFMT])
        if not (BINFMT / "qemu-aarch64").exists():
            (BINFMT / "register").write_bytes(_FORMAT % QEMU.encode())
    except (AssertionError, OSError) as error:
        pytest.skip(f"the kernel starts no programs of other machines: {error}")


def _run(
    argv: list[str | Path], cwd: Path | None = None, env: dict[str, str] | None = None
) -> str:
    done = subprocess.run(
        argv,
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        timeout=_LIMIT,
        check=False,
    )
    assert done.returncode == 0, f"{argv}: {done.stdout}{done.stderr}"
    return done.stdout
