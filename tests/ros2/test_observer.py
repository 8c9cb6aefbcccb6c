"""Which process a node is in, as its middleware tells."""

from __future__ import annotations

import os
from types import SimpleNamespace

import pytest

from poise.errors import RunError
from poise.session.ros2_import.graph_records import Graph, Hardware
from poise.session.ros2_import.import_robot import import_robot
from poise.session.ros2_import.node_processes import ProcessUsage

FAST_DDS, CYCLONE = b"\x01\x0f", b"\x01\x10"
HERE, THERE = b"\x2b\xc0", b"\x2b\xc1"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vendor", "host", "why"),
    [
        (FAST_DDS, HERE, ""),
        (FAST_DDS, THERE, "it runs on another computer"),
        (CYCLONE, THERE, "only Fast DDS tells the process of a node"),
    ],
)
def test_why_the_process_of_a_node_is_not_known(
    vendor: bytes, host: bytes, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from poise.session.ros2_import import observer  # noqa: PLC0415, rclpy may lack

    def endpoint(vendor: bytes, host: bytes) -> SimpleNamespace:
        return SimpleNamespace(endpoint_gid=[*vendor, *host, *bytes(12)])

    monkeypatch.setattr(observer, "find_pid", lambda _: os.getpid())
    seen = object.__new__(observer._Observer)
    seen._pids, seen._elsewhere, seen._nodes = {}, {}, set()
    seen._usage = ProcessUsage()
    ends = {"/poise_import": endpoint(FAST_DDS, HERE), "/a": endpoint(vendor, host)}
    monkeypatch.setattr(seen, "_names", lambda: {"/a"})
    monkeypatch.setattr(seen, "_endpoints", lambda: ends)
    seen._find_nodes()
    assert seen._elsewhere.get("/a", "").startswith(why)
    assert ("/a" in seen._pids) is not bool(why)


@pytest.mark.slow
def test_says_which_process_a_node_of_another_host_may_be() -> None:
    from poise.session.ros2_import import observer  # noqa: PLC0415, where ROS 2 is

    assert observer._other_host(None) == "it runs on another computer"
    assert "or it is process 7 here" in observer._other_host(7)


@pytest.mark.slow
def test_a_graph_without_a_process_becomes_no_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from poise.session.ros2_import import observer  # noqa: PLC0415, where ROS 2 is

    graph = Graph(
        computer=Hardware(name="board", cores=2.0, memory=1e9),
        seconds=1.0,
        elsewhere={"/b": "it runs on another computer", "/a": "no Fast DDS"},
    )
    monkeypatch.setattr(observer, "observe", lambda _: graph)
    with pytest.raises(RunError) as said:
        import_robot(1.0)
    assert str(said.value) == (
        "there is no node here that can be imported\n"
        "/a: no Fast DDS\n/b: it runs on another computer"
    )


@pytest.mark.slow
def test_says_which_names_several_nodes_have() -> None:
    from poise.session.ros2_import.observer import remarks_on  # noqa: PLC0415, where ROS 2 is

    ended, twice = remarks_on({"/gone", "/ear"}, ["/ear", "/mouth", "/ear"])
    assert ended == "/gone ended meanwhile"
    assert twice.startswith("2 nodes are called /ear, of which at most one is seen")


@pytest.mark.slow
def test_says_why_ros2_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    from poise.session.ros2_import.observer import observe  # noqa: PLC0415, as above

    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(RunError, match=r"does not start: .* is not an integral number"):
        observe(1.0)
