"""Addresses of containers as text."""

from __future__ import annotations

import pytest

from poise.endpoint import Endpoint
from poise.wire.address import Address
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
    with pytest.raises(WireError, match="is no address of a container"):
        Address.parse(text)
