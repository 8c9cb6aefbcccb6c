"""Hosts and ports as text."""

from __future__ import annotations

import pytest

from poise.endpoint import Endpoint


@pytest.mark.parametrize(
    ("text", "endpoint", "shown"),
    [
        ("10.0.0.1", Endpoint("10.0.0.1", 7447), "10.0.0.1:7447"),
        ("10.0.0.1:7500", Endpoint("10.0.0.1", 7500), "10.0.0.1:7500"),
        ("robot.local", Endpoint("robot.local", 7447), "robot.local:7447"),
        ("robot:80", Endpoint("robot", 80), "robot:80"),
        ("fd00::1", Endpoint("fd00::1", 7447), "[fd00::1]:7447"),
        ("[fd00::1]", Endpoint("fd00::1", 7447), "[fd00::1]:7447"),
        ("[fd00::1]:7500", Endpoint("fd00::1", 7500), "[fd00::1]:7500"),
        ("::1", Endpoint("::1", 7447), "[::1]:7447"),
    ],
)
def test_reads_hosts_with_and_without_ports(
    text: str, endpoint: Endpoint, shown: str
) -> None:
    assert Endpoint.parse(text) == endpoint
    assert str(endpoint) == shown
    assert Endpoint.parse(shown) == endpoint


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("10.77.0.999", "'10.77.0.999' is not a valid IPv4 address"),
        ("10.0.0", "'10.0.0' is not a valid IPv4 address"),
        ("host:abc", "the port 'abc' must be a number from 1 to 65535"),
        ("host:", "the port '' must be a number"),
        ("host:0", "the port '0' must be a number"),
        ("host:65536", "the port '65536' must be a number"),
        ("fe80::1::2", "'fe80::1::2' is not a valid IPv6 address"),
        ("fe80::1", "'fe80::1' is a link-local address, which each computer reaches"),
        ("[fe80::1%eth0]:7500", "'fe80::1%eth0' is a link-local address"),
        ("[fe80::1]7447", "is not a valid host name|is not a valid IPv6 address"),
        ("[fd00::1]:x", "the port 'x' must be a number"),
        ("[10.0.0.1]:80", "only IPv6 addresses take brackets"),
        ("", "'' is not a valid host name"),
        ("two words", "'two words' is not a valid host name"),
        ("tcp/10.0.0.1", "is not a valid host name"),
    ],
)
def test_names_the_fault_and_the_accepted_forms(text: str, fault: str) -> None:
    with pytest.raises(ValueError, match=fault) as error:
        Endpoint.parse(text)
    assert r"[fd00::2]:7447" in str(error.value)
