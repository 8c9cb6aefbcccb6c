"""A hash changes with what an architecture runs, and with nothing else."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.estimate.code_version import hash_of
from poise.model.robot import Architecture, ComponentEntry

EYE = ComponentEntry(name="eye", implementation="sight:Eye", parameters={"gain": 1})
SEEING = Architecture(name="seeing", function="sight", components=(EYE,))


@pytest.fixture
def folder(tmp_path: Path) -> str:
    (tmp_path / "sight.py").write_text("class Eye: ...")
    return str(tmp_path)


def test_stays_when_only_the_planner_would_notice(folder: str) -> None:
    """A demand from a profile, a quality, and where its file lies."""
    measured = replace(
        SEEING,
        quality=0.5,
        success=0.3,
        file="/elsewhere/seeing.yaml",
        components=(replace(EYE, demand={"cpu": 0.5}, state=10.0),),
    )
    assert hash_of(measured, [folder]) == hash_of(SEEING, [folder])


def test_changes_with_parameters_and_code(folder: str) -> None:
    """Also with code in a folder of the repository."""
    before = hash_of(SEEING, ["/nowhere", folder])
    other = replace(SEEING, components=(replace(EYE, parameters={"gain": 2}),))
    assert hash_of(other, ["/nowhere", folder]) != before
    (Path(folder) / "sight.py").write_text("class Eye: 'changed'")
    assert hash_of(SEEING, ["/nowhere", folder]) != before


def test_covers_the_files_of_an_installed_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package that implements it, not only its version."""
    package = tmp_path / "installed_sight"
    package.mkdir()
    code = package / "__init__.py"
    code.write_text("raise RuntimeError('imported')")
    monkeypatch.syspath_prepend(tmp_path)
    eye = replace(EYE, implementation="installed_sight:Eye")
    seeing = replace(SEEING, components=(eye,), package="installed-sight 1.0")
    before = hash_of(seeing, ())
    code.write_text("raise RuntimeError('changed')")
    assert hash_of(seeing, ()) != before
