"""Addresses of computers in robot files."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """\
robot: r
computers:
  left: {{cpu: 1, memory: 1 GiB, {left}}}
  right: {{cpu: 1, memory: 1 GiB, {right}}}
"""


def robot(left: str, right: str) -> str:
    return ROBOT.format(left=left, right=right).replace(", }", "}")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        (
            "10.77.0.999",
            ["'10.77.0.999' is not a valid IPv4 address", "[fd00::2]:7447"],
        ),
        ("host:abc", ["the port 'abc' must be a number from 1 to 65535"]),
        ("fe80:::1", ["'fe80:::1' is not a valid IPv6 address"]),
    ],
)
def test_an_address_that_is_none_is_a_problem_at_its_place(
    refuse: Refuse, address: str, words: list[str]
) -> None:
    refuse(robot("address: 10.77.0.1", f"▸address: '{address}'"), *words)


def test_two_computers_with_one_address_are_a_problem(refuse: Refuse) -> None:
    text = robot("address: 10.77.0.1", "▸address: '10.77.0.1:7447'")
    refuse(text, "'left' and 'right' have the same address 10.77.0.1:7447")


def test_a_computer_without_an_address_beside_one_with_is_a_problem(
    refuse: Refuse,
) -> None:
    text = robot("address: 10.77.0.1", "").replace("  right", "  ▸right")
    refuse(text, "'right' has no address", "'left'", "give all", "none")


def test_addresses_of_both_families_and_names_are_taken(find: Find) -> None:
    assert find(robot("address: '[fd00::2]:7447'", "address: robot.local:7500")) == ()
    assert find(robot("address: fd00::1", "address: 10.0.0.1")) == ()
