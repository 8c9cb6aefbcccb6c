"""Writes a profile's demands into the robot file."""

from __future__ import annotations

from pathlib import Path

from poise.estimate.demands import cpu_demand, memory_demand
from poise.estimate.profile import ComponentProfile, Profile
from poise.model.load import load_source
from poise.model.yaml.edit import with_values

_MIB = 2**20


def write_demands(file: Path, profile: Profile) -> list[Path]:
    """Write the demands of `profile` under the components of a robot file.

    Comments and layout of the file, of included files and of those in folders of
    `repository` are kept. Files of installed packages are not changed.

    Returns
    -------
    The files that changed.

    Raises
    ------
    RobotError
        The robot file has a problem; nothing was written.
    """
    source = load_source(file)
    paths = [
        ("architectures", architecture.name, "components", component.name)
        for architecture in source.robot.architectures
        for component in architecture.components
        if component.name in profile.components and not architecture.package
    ]
    places = {path: source.positions.at(path) for path in paths}
    before = {p.file: Path(p.file).read_text("utf-8") for p in places.values()}
    texts = before
    # from last to first: added lines move only what is done
    for path in sorted(paths, key=lambda path: -places[path].line):
        values = _values(profile.components[path[-1]])
        texts = with_values(texts, source.positions, path, values)
    changed = [name for name in texts if texts[name] != before[name]]
    for name in changed:
        Path(name).write_text(texts[name], "utf-8")
    return [Path(name) for name in changed]


def _values(found: ComponentProfile) -> dict[str, str]:
    return {
        "cpu": f"{100 * cpu_demand(found):.3g}%",
        "memory": f"{memory_demand(found) / _MIB:.3g} MiB",
    }
