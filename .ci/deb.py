"""Pack the wheel of this machine, and all that it needs, for Debian 12.

It is installed as a virtual environment in ``/opt/poise``, and needs no package index:
``dpkg --install dist/poise_*.deb``. `make wheels` comes before.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
CONTROL = """\
Package: poise
Version: {version}
Architecture: {architecture}
Maintainer: The Poise developers
Depends: python3 (>= 3.11), python3 (<< 3.12), python3-venv
Description: Keeps a robot's software in balance over its on-board computers
"""
AFTER = """\
#!/bin/sh
set -e
/usr/bin/python3 -m venv --clear /opt/poise
/opt/poise/bin/pip install --quiet --no-index --no-deps /usr/share/poise/*.whl
"""
BEFORE = "#!/bin/sh\nrm -rf /opt/poise\n"


def main() -> None:
    """Write the package into ``dist``."""
    found = [*(ROOT / "dist").glob(f"poise-*-cp311-*{platform.machine()}.whl")]
    if not found:
        raise SystemExit("there is no wheel for Python 3.11 in dist: run `make wheels`")
    words = ("dpkg", "--print-architecture")
    architecture = subprocess.check_output(words, text=True).strip()
    version, tree = found[0].name.split("-")[1], ROOT / "build" / "deb"
    shutil.rmtree(tree, ignore_errors=True)
    wheels, about = tree / "usr/share/poise", tree / "DEBIAN"
    for folder in (wheels, about, tree / "usr/bin"):
        folder.mkdir(parents=True)
    shutil.copy(found[0], wheels)
    (tree / "usr/bin/poise").symlink_to("/opt/poise/bin/poise")
    control = CONTROL.format(version=version, architecture=architecture)
    (about / "control").write_text(control)
    for name, script in (("postinst", AFTER), ("prerm", BEFORE)):
        (about / name).write_text(script)
        (about / name).chmod(0o755)
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    pip += ["--only-binary=:all:", "--python-version=3.11", "--require-hashes"]
    pip += ["--requirement", str(ROOT / "dependencies.txt"), "--dest", str(wheels)]
    subprocess.run([*pip, "--disable-pip-version-check"], check=True)
    target = ROOT / "dist" / f"poise_{version}_{architecture}.deb"
    subprocess.run(
        ["dpkg-deb", "--build", "--root-owner-group", tree, target], check=True
    )


if __name__ == "__main__":
    main()
