"""Addresses of containers, as text and as sockets."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from poise.endpoint import Endpoint
from poise.wire.address import (
    LONGEST,
    RESEND_EVERY,
    TCP_RTO_MAX_MS,
    Address,
    gateway_path,
    socket_path,
    tune,
)
from poise.wire.codec import WireError


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("navigator", Address("navigator")),
        ("mind.heavy", Address("mind.heavy")),
        ("10.0.0.2:40123/mind", Address("mind", Endpoint("10.0.0.2", 40123))),
        ("[fd00::2]:40123/mind", Address("mind", Endpoint("fd00::2", 40123))),
    ],
)
def test_an_address_comes_back_from_its_text(text: str, address: Address) -> None:
    assert Address.parse(text) == address
    assert str(address) == text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "/mind",
        "10.0.0.2/mind",
        "10.0.0.2:99999/mind",
        "robot.example:80/mind",  # it would have to be looked up
        "10.0.0.2:80/",
        "../mind",
        "fd00::2:40123/mind",  # the port could be a part of the address
        "None/mind",
    ],
)
def test_what_is_none_is_refused(text: str) -> None:
    with pytest.raises(WireError, match="is not the address of a container"):
        Address.parse(text)


@pytest.mark.slow
def test_tcp_sends_again_each_second_at_least() -> None:
    """Else a stream is silent for 3 s after a cut of 3 s."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        tune(listening)
        with socket.create_connection(listening.getsockname()) as ours:
            tune(ours)
            theirs, _ = listening.accept()
            with theirs:
                try:
                    found = [
                        end.getsockopt(socket.IPPROTO_TCP, TCP_RTO_MAX_MS)
                        for end in (ours, theirs)
                    ]
                except OSError:
                    pytest.skip("before Linux 6.15 there is no limit to set")
    assert found == [RESEND_EVERY, RESEND_EVERY]


@pytest.mark.slow
def test_the_longest_folder_has_room_for_all_sockets_of_a_container(
    tmp_path: Path,
) -> None:
    room = LONGEST - len(socket_path(Path("/"), "mind").name) - 1
    folder = tmp_path / ("x" * (room - len(str(tmp_path)) - 1))
    folder.mkdir()
    for path in (socket_path(folder, "mind"), gateway_path(folder, "mind")):
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(str(path))
    with pytest.raises(ValueError, match="choose another"):
        socket_path(folder.with_name(folder.name + "x"), "mind")
