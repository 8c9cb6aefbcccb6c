"""The workload: its ports exist, and it is not empty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from poise.model.check.file_paths import component_names
from poise.model.check.ports import KnownPort
from poise.model.robot import Robot
from poise.model.yaml.positions import Finding
from poise.suggest import listed, unknown


def check_workload(robot: Robot) -> Iterator[Finding]:
    """Yield ports of unknown components, and an empty workload."""
    workload = robot.workload
    if workload is None:
        return
    if not (workload.command or workload.recording or workload.generate):
        yield Finding(
            ("workload",), "the workload is empty: give command, recording or generate"
        )
    names = component_names(robot)
    for each in workload.generate:
        path = ("workload", "generate", str(each.port))
        if each.port.component not in names:
            yield Finding(path, unknown("component", each.port.component, names))
        elif not each.port.port:
            yield Finding(path, f"give the port, as in {each.port.component}.scan")


def check_generated(
    robot: Robot, known: Mapping[str, Mapping[str, KnownPort]]
) -> Iterator[Finding]:
    """Yield generated messages for ports that do not subscribe."""
    for each in robot.workload.generate if robot.workload else ():
        ports = known.get(each.port.component)
        if ports is None:
            continue  # its code is faulty, which is reported already
        subscribing = [
            name for name, port in ports.items() if port.kind == "subscribes"
        ]
        if each.port.port not in subscribing:
            yield Finding(
                ("workload", "generate", str(each.port)),
                f"'{each.port.component}' subscribes to no '{each.port.port}'; it "
                f"subscribes to {listed(subscribing)}",
            )
