"""``python -m poise.cmake``: prints the folder that CMake's ``poise_DIR`` names."""

from pathlib import Path


def folder() -> Path:
    """Return the folder of ``poiseConfig.cmake``."""
    return Path(__file__).parent / "cpp"


if __name__ == "__main__":
    print(folder())  # noqa: T201, that is its job
