"""What components in C++ are built with: ``python -m poise.cmake`` prints the folder.

CMake's ``poise_DIR`` names it.
"""

from hashlib import blake2s
from pathlib import Path

from poise.version import VERSION


def folder() -> Path:
    """Return the folder of ``poiseConfig.cmake``."""
    return Path(__file__).parent / "cpp"


def headers() -> list[Path]:
    """Return what components include."""
    return sorted((folder() / "include/poise").glob("*.hpp"))


def release() -> str:
    """Return the version of Poise, and last a checksum of its headers."""
    digest = blake2s(digest_size=4)
    for header in headers():
        digest.update(header.read_bytes())
    return f"{VERSION}, headers {digest.hexdigest()}"


def check_built(module: str, built_for: str) -> None:
    """Raise ImportError when a module was built with other headers than are here."""
    here = release()
    if built_for.rpartition(" ")[2] != here.rpartition(" ")[2]:
        raise ImportError(
            f"'{module}' was built for Poise {built_for}, but this is Poise {here}: "
            "build it again"
        )


if __name__ == "__main__":
    print(folder())  # noqa: T201, that is its job
