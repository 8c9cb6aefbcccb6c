"""Edits keep what people wrote: comments, order, layout."""

from pathlib import Path

import pytest

from poise.model.loading import load_source
from poise.model.yaml_tree import with_values

BLOCK = """\
robot: r # mine
computers:
  main: {cpu: 4, memory: 1 GiB}
architectures:
  see:
    function: seeing
    components:
      eye: # the left one
        implementation: "pkg.eye:Eye" # imported late
        cpu: 20%   # guessed
        parameters: {cpu: 5 ms}
      mind: {implementation: "pkg.mind:Mind", memory: 8 MiB, parameters: {memory: 3}}
"""
VALUES = {"cpu": "12%", "memory": "9 MiB"}


def edited(tmp_path: Path, component: str) -> str:
    file = tmp_path / "robot.yaml"
    file.write_text(BLOCK)
    path = ("architectures", "see", "components", component)
    texts = {str(file): BLOCK}
    positions = load_source(file).positions
    return with_values(texts, positions, path, VALUES)[str(file)]


def test_edits_a_block(tmp_path: Path) -> None:
    expected = BLOCK.replace("cpu: 20%   # guessed", "cpu: 12%   # guessed").replace(
        '        implementation: "pkg.eye',
        '        memory: 9 MiB\n        implementation: "pkg.eye',
    )
    assert edited(tmp_path, "eye") == expected


def test_edits_a_mapping_in_braces(tmp_path: Path) -> None:
    expected = BLOCK.replace("memory: 8 MiB", "memory: 9 MiB").replace(
        "mind: {implementation", "mind: {cpu: 12%, implementation"
    )
    assert edited(tmp_path, "mind") == expected


@pytest.mark.parametrize("component", ["eye", "mind"])
def test_what_was_edited_is_read_again(tmp_path: Path, component: str) -> None:
    (tmp_path / "robot.yaml").write_text(edited(tmp_path, component))
    robot = load_source(tmp_path / "robot.yaml").robot
    (found,) = (c for c in robot.components() if c.name == component)
    assert found.demand == pytest.approx({"cpu": 0.12, "memory": 9 * 2**20})
    assert found.parameters in ({"cpu": "5 ms"}, {"memory": 3})
