from pathlib import Path

import pytest

from poise.estimate.code_version import version_of
from poise.model.check.ros2_components import NODE
from poise.model.robot import ComponentEntry
from poise.model.ros2_node import Ros2Node


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    package = tmp_path / "pkg"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "eye.py").write_text("import math\nfrom pkg import lens\n")
    (package / "lens.py").write_text("from .glass import Glass\n")
    (package / "glass.py").write_text("class Glass: ...\n")
    (package / "other.py").write_text("")
    return tmp_path


EYE = ComponentEntry(name="eye", implementation="pkg.eye:Eye", parameters={"rate": 1})


@pytest.mark.parametrize("module", ["eye", "lens", "glass", "__init__"])
def test_changes_with_the_module_and_what_it_imports(folder: Path, module: str) -> None:
    before = version_of(EYE, str(folder))
    file = folder / "pkg" / f"{module}.py"
    file.write_text(file.read_text() + "x = 1\n")
    assert version_of(EYE, str(folder)) != before


def test_changes_with_a_module_in_cpp(folder: Path) -> None:
    (folder / "built.cpython-311-x86_64-linux-gnu.so").write_bytes(b"\x7fELF\0one")
    component = ComponentEntry(name="a", implementation="built:Class")
    before = version_of(component, str(folder))
    (folder / "built.cpython-311-x86_64-linux-gnu.so").write_bytes(b"\x7fELF\0other")
    assert version_of(component, str(folder)) != before


def test_does_not_change_with_other_modules(folder: Path) -> None:
    before = version_of(EYE, str(folder))
    (folder / "pkg" / "other.py").write_text("y = 2\n")
    assert version_of(EYE, str(folder)) == before


def test_changes_with_the_parameters(folder: Path) -> None:
    other = ComponentEntry(
        name="eye", implementation="pkg.eye:Eye", parameters={"rate": 2}
    )
    assert version_of(other, str(folder)) != version_of(EYE, str(folder))


def test_covers_a_command_and_the_files_it_names(folder: Path) -> None:
    script = folder / "run.sh"
    script.write_text("true\n")
    component = ComponentEntry(name="c", command=("sh", "run.sh", "-v"))
    before = version_of(component, str(folder))
    script.write_text("false\n")
    assert version_of(component, str(folder)) != before


@pytest.mark.parametrize("changed", ["pkg/eye.py", "params.yaml"])
def test_covers_the_class_of_a_ros2_node_and_its_parameters(
    folder: Path, changed: str
) -> None:
    (folder / "params.yaml").write_text("{}\n")
    node = Ros2Node(node="pkg.eye:Eye", params_files=("params.yaml",))
    component = ComponentEntry(name="eye", implementation=NODE, ros2=node)
    before = version_of(component, str(folder))
    (folder / changed).write_text("# other\n")
    assert version_of(component, str(folder)) != before


def test_a_word_of_a_command_may_be_longer_than_a_file_name(folder: Path) -> None:
    script = "sleep 1; " * 100
    component = ComponentEntry(name="c", command=("sh", "-c", script))
    assert version_of(component, str(folder))


def test_survives_code_that_is_no_python(folder: Path) -> None:
    (folder / "pkg" / "eye.py").write_text("def (")
    assert version_of(EYE, str(folder))
