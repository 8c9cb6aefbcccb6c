"""Which code an agent lets a manager run."""

from __future__ import annotations

import pytest

from poise.runtime.agent.allowed_code import refusal
from poise.wire.records.deployment_records import ComponentSpec, ContainerSpec


def container(
    folder: str, *command: str, repository: tuple[str, ...] = ()
) -> ContainerSpec:
    component = ComponentSpec(name="camera", goal="active", command=command)
    return ContainerSpec(
        name="main",
        folder=folder,
        repository=repository,
        components=(component,),
        connectors=(),
    )


@pytest.mark.parametrize(
    "allowed",
    [
        container("/opt/robot"),
        container("/opt/robot/v2", repository=("/opt/robot/more",)),
        container("/opt/robot", "./drive", "--fast"),
        container("/opt/robot", "/opt/robot/bin/drive"),
    ],
)
def test_what_is_in_an_allowed_folder_runs(allowed: ContainerSpec) -> None:
    assert not refusal([allowed], ["/srv", "/opt/robot"])


@pytest.mark.parametrize(
    ("refused", "what"),
    [
        (container("/tmp"), "code of container 'main' is at /tmp"),
        (container("/opt/robot/../../tmp"), "code of container 'main' is at /tmp"),
        (container("/opt/robots"), "code of container 'main' is at /opt/robots"),
        (container("/opt/robot", repository=("/tmp",)), "is at /tmp"),
        (container("/opt/robot", "sh", "-c", "id"), "the program of 'camera' is at /"),
        (container("/opt/robot", "../sh"), "the program of 'camera' is at /opt/sh"),
        (container("/opt/robot", "nosuch"), "at an unknown place"),
    ],
)
def test_what_is_elsewhere_is_refused(refused: ContainerSpec, what: str) -> None:
    said = refusal([container("/opt/robot"), refused], ["/opt/robot"])
    assert what in said
    assert "only runs what is in /opt/robot (`poise agent --allow`)" in said


def test_without_folders_everything_runs() -> None:
    assert not refusal([container("/tmp", "sh")], [])
