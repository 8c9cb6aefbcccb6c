"""A software bill of materials in CycloneDX 1.6: ``python .ci/sbom.py > FILE``.

It lists Poise, what it needs at run time as locked in `constraints.txt`, and what is
compiled into its modules. The same commit gives the same text.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path

from poise.version import VERSION

ROOT = Path(__file__).parents[1]
COMPILED_IN = ("nanobind", "ziglang")
"""The bindings, and the compiler with its C++ library."""


def locked() -> dict[str, str]:
    """Return version by name, as locked."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = (line.partition("==") for line in lines if "==" in line)
    return {bare(name): version for name, _, version in pairs}


def bare(name: str) -> str:
    """Return a package's name as registries compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(package: str) -> Iterator[str]:
    """Yield what a package needs itself, without extras and other systems."""
    for line in requires(package) or ():
        if "extra ==" not in line and "platform_system ==" not in line:
            yield bare(re.split(r"[ <>=!~;\[(]", line)[0])


def closure(package: str) -> dict[str, list[str]]:
    """Return what each package needs that `package` needs, that included."""
    found: dict[str, list[str]] = {}
    waiting = [package]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        try:
            found[name] = sorted(set(needed(name)))
        except PackageNotFoundError:  # for another Python or computer
            continue
        waiting += found[name]
    return found


def component(name: str, version: str) -> dict[str, object]:
    """Return one entry."""
    try:
        about = metadata(name)
        given = [
            about[key] for key in ("License-Expression", "License") if key in about
        ]
        licence = next(filter(None, given), "")
    except PackageNotFoundError:
        licence = ""
    is_short = licence and "\n" not in licence
    return {
        "type": "library",
        "bom-ref": f"pkg:pypi/{name}@{version}",
        "name": name,
        "version": version,
        "purl": f"pkg:pypi/{name}@{version}",
        **({"licenses": [{"license": {"name": licence}}]} if is_short else {}),
    }


def main() -> int:
    """Write the bill."""
    versions = locked() | {"poise": VERSION}
    needs = closure("poise")
    named = sorted({*needs, *COMPILED_IN})
    if missing := [name for name in named if name not in versions]:
        raise SystemExit(f"constraints.txt lacks {', '.join(missing)}: `make lock`")
    entries = {name: component(name, versions[name]) for name in named}
    references = {name: entry["bom-ref"] for name, entry in entries.items()}
    needs["poise"] = [*needs["poise"], *COMPILED_IN]
    bill = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": entries.pop("poise")},
        "components": list(entries.values()),
        "dependencies": [
            {
                "ref": references[name],
                "dependsOn": [
                    references[x] for x in needs.get(name, ()) if x in entries
                ],
            }
            for name in named
        ],
    }
    json.dump(bill, sys.stdout, indent=1)
    sys.stdout.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
