"""How fast and how good placement is: ``python -m benchmarks.placement --help``."""
