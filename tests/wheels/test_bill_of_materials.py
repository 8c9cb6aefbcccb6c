"""The bill of materials that `make wheels` writes beside them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from poise.version import VERSION

BILL = Path(__file__).parents[2] / ".ci/sbom.py"


@pytest.mark.slow
def test_the_bill_names_poise_and_what_it_needs_with_their_versions() -> None:
    command = [sys.executable, str(BILL)]
    bill = json.loads(subprocess.check_output(command, timeout=60))
    assert bill["metadata"]["component"]["version"] == VERSION
    versions = {part["name"]: part["version"] for part in bill["components"]}
    assert {"eclipse-zenoh", "msgspec", "nanobind", "ziglang"} <= versions.keys()
    assert all(versions.values())
