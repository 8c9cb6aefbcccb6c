"""Sessions of zenoh."""

from __future__ import annotations

import socket

import pytest

from poise.endpoint import Endpoint
from poise.errors import RunError
from poise.wire.control_session import locator, open_session


@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "why"),
    [("203.0.113.9:7447", "Cannot assign"), ("127.0.0.1:{busy}", "in use")],
)
def test_an_address_that_cannot_be_had_is_an_error(address: str, why: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        endpoint = "tcp/" + address.format(busy=busy.getsockname()[1])
        with pytest.raises(RunError, match=f"cannot listen on {endpoint}: .*{why}"):
            open_session(listen=[endpoint])


def test_the_last_part_of_an_ipv6_address_is_no_port() -> None:
    assert locator(Endpoint.parse("fd00::2")) == "tcp/[fd00::2]:7447"
