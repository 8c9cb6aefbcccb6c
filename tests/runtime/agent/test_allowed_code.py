"""Which code an agent lets a manager run."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.runtime.agent.allowed_code import refusal, refusal_of_code
from poise.runtime.agent.surroundings import DEPLOYED
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
        (container("/opt/robot", "ros2:package/nosuch"), "at an unknown place"),
    ],
)
def test_what_is_elsewhere_is_refused(refused: ContainerSpec, what: str) -> None:
    said = refusal([container("/opt/robot"), refused], ["/opt/robot"])
    assert what in said
    assert "only runs what is in /opt/robot (`poise agent --allow`)" in said


def test_without_folders_everything_runs() -> None:
    assert not refusal([container("/tmp", "sh")], [])


VERSION = "a" * 64


def deployed(*command: str) -> ContainerSpec:
    return replace(container("", *command), code=VERSION)


@pytest.mark.parametrize("allowed", [[], [DEPLOYED], ["/opt/robot", DEPLOYED]])
def test_deployed_code_runs_where_it_is(allowed: list[str]) -> None:
    containers = [deployed(), deployed("./drive")]
    assert not refusal(containers, allowed, [VERSION])
    assert not refusal_of_code(allowed)
    said = refusal(containers, allowed, ["b" * 64])
    assert (
        "it does not have version aaaaaaaaaaaa of the robot's code: run `poise" in said
    )


@pytest.mark.parametrize(
    "refused",
    [
        deployed("../drive"),
        deployed("/bin/sh"),
        deployed("sh"),
        deployed("ros2:package/nosuch"),
        container("/tmp"),
        container(DEPLOYED),  # a folder of this name where the agent was started
        container("", f"{DEPLOYED}/drive"),
    ],
)
def test_other_code_is_refused_where_only_deployed_code_runs(
    refused: ContainerSpec,
) -> None:
    said = refusal([refused], [DEPLOYED], [VERSION])
    assert "only runs what is deployed (`poise agent --allow`); `poise deploy" in said


def test_no_code_is_sent_where_only_folders_are_allowed() -> None:
    said = refusal([deployed()], ["/opt/robot"], [VERSION])
    assert "is at deployed, and this agent only runs what is in /opt/robot" in said
    assert "`poise agent --allow deployed`, too" in refusal_of_code(["/opt/robot"])
