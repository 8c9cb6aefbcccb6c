"""Classes are found by the name in the robot file, or an error says why not."""

import sys
from pathlib import Path
from uuid import uuid4

import pytest

from poise import Component
from poise.errors import RobotError
from poise.runtime.component.implementation import find, find_function, find_type


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make an empty package; its name is new, as Python keeps what it imported."""
    monkeypatch.setattr("sys.path", list(sys.path))
    folder = tmp_path / f"package_{uuid4().hex}"
    folder.mkdir()
    (folder / "__init__.py").touch()
    return folder


def write(package: Path, code: str) -> str:
    """Write a module of the package; return its name."""
    (package / "nav.py").write_text(code)
    return f"{package.name}.nav"


def error_of(module: str, name: str, package: Path) -> str:
    with pytest.raises(RobotError) as error:
        find(f"{module}:{name}", str(package.parent))
    return str(error.value)


def test_finds_a_component_beside_the_robot_file(package: Path) -> None:
    module = write(package, "import poise\nclass Nav(poise.Component): pass\n")
    found = find(f"{module}:Nav", str(package.parent))
    assert issubclass(found, Component)
    assert found.__qualname__ == "Nav"


def test_finds_an_inner_class(package: Path) -> None:
    module = write(package, "class Outer:\n    class Inner: pass\n")
    found = find_type(f"{module}:Outer.Inner", str(package.parent))
    assert found.__qualname__ == "Outer.Inner"


def test_a_missing_module_is_told_with_where_it_is_looked_for(package: Path) -> None:
    message = error_of(f"{package.name}.nvv", "Nav", package)
    assert f"there is no module '{package.name}.nvv'" in message
    assert str(package.parent) in message


def test_a_missing_package_is_told(package: Path) -> None:
    assert "there is no module 'nowhere'" in error_of("nowhere.nav", "Nav", package)


def test_a_missing_class_is_told_with_the_close_one(package: Path) -> None:
    module = write(
        package,
        "import poise\nfrom pathlib import Path\nclass Nav(poise.Component): pass\n",
    )
    message = error_of(module, "Nva", package)
    assert f"{module} has no class 'Nva' (did you mean 'Nav'?)" in message
    assert message.endswith("classes: 'Nav'")


def test_a_missing_function_is_told_with_the_close_one(package: Path) -> None:
    module = write(package, "class Nav: pass\ndef adapt(old): return old\n")
    with pytest.raises(RobotError, match=r"has no function 'adopt' .* 'adapt'") as told:
        find_function(f"{module}:adopt", str(package.parent))
    assert str(told.value).endswith("functions: 'adapt'")


def test_a_class_that_is_no_component_is_refused(package: Path) -> None:
    module = write(package, "class Nav: pass\n")
    assert "must inherit from poise.Component" in error_of(module, "Nav", package)


@pytest.mark.parametrize("module", ["queue", "json.nav"])
def test_a_module_with_the_name_of_one_of_pythons_is_told(
    package: Path, module: str
) -> None:
    told = error_of(module, "Nav", package)
    assert f"'{module.partition('.')[0]}' is a module of Python's" in told


def test_what_is_no_class_is_refused(package: Path) -> None:
    module = write(package, "def nav(): pass\n")
    assert "is of type function, not a class" in error_of(module, "nav", package)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("def f():\n    raise KeyError('k')\nf()\n", ["KeyError: 'k'", "line 2, in f"]),
        ("import not_there_at_all\n", ["No module named 'not_there_at_all'", "line 1"]),
        ("import sys\nsys.exit(3)\n", ["SystemExit: 3", "line 2"]),
        ("raise BaseException('panic')\n", ["BaseException: panic", "line 1"]),
        ("def f(:\n", ["SyntaxError", "nav.py"]),
        ("import poise\npoise.every(freq=1)\n", ["takes 'period', 'hz', 'deadline'"]),
    ],
)
def test_what_a_module_raises_is_told_with_its_traceback(
    package: Path, code: str, words: list[str]
) -> None:
    module = write(package, code)
    message = error_of(module, "Nav", package)
    assert f"the module '{module}' cannot be imported" in message
    assert all(word in message for word in words), message
    assert "importlib" not in message
