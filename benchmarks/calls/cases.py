"""What is measured: a table."""

from __future__ import annotations

from msgspec import Struct

SMALL = (64, 4096)
LARGE = (1 << 20, 6 << 20)
ALL = SMALL + LARGE


class Case(Struct, frozen=True):
    """One row: a system under `benchmarks.calls.systems`, and what its row says.

    `key` names its median at 64 B in the JSON output, in [us].
    """

    title: str
    module: str
    sizes: tuple[int, ...] = ALL
    key: str = ""
    alone: bool = False


CASES = (
    Case("bare Python call", "bare", (64,), "bare_us", alone=True),
    Case("Poise direct call", "poise_direct", ALL, "direct_us", alone=True),
    Case("C++ calls C++, direct", "cpp_direct", SMALL, "cpp_direct_us", alone=True),
    Case("Python calls C++, direct", "cpp_callee", SMALL, "cpp_callee_us", alone=True),
    Case("C++ calls Python, direct", "cpp_caller", SMALL, "cpp_caller_us", alone=True),
    Case("AF_UNIX ping-pong", "unix", key="floor_unix_us"),
    Case("Poise same computer, call", "poise_local_call", key="same_computer_us"),
    Case("C++ same computer, call", "cpp_local_call", key="cpp_same_computer_us"),
    Case("Poise same computer, loans", "poise_local_loan", LARGE),
    Case("Poise same computer, topic", "poise_local_topic", key="local_topic_us"),
    Case("pyzmq REQ/REP over ipc", "pyzmq", key="pyzmq_us"),
    Case("iceoryx2 request/response", "iceoryx", key="iceoryx2_us"),
    Case("zenoh query", "zenoh_query", key="zenoh_query_us"),
    Case("Poise remote, call", "poise_remote_call", key="remote_us"),
    Case("zenoh put/subscriber", "zenoh_topic", key="zenoh_put_us"),
    Case("Poise remote, topic", "poise_remote_topic", key="remote_topic_us"),
    Case("rclpy service", "rclpy_service", key="rclpy_service_us"),
    Case("rclpy topic", "rclpy_topic", key="rclpy_topic_us"),
)
