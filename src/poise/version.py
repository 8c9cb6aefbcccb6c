"""The version of Poise, from which `pyproject.toml` takes that of the package."""

VERSION = "0.2.0"
