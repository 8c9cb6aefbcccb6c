"""Functions that a robot file only names are provided by the repository."""

from collections.abc import Callable
from pathlib import Path

import pytest

from poise.errors import FileProblem, RobotError
from poise.model import load
from poise.model.loading import load_source

Write = Callable[[str, str], Path]

ROBOT = """
robot: courier
repository: [parts]
computers: {main: {cpu: 1, memory: 1 GiB}}
tasks: {deliver: {actions: [{name: drive, functions: [navigation]}]}}
"""
LASER = """
architectures:
  laser_navigator:
    function: navigation
    components: {scanner: {cpu: 10%}}
"""
CAMERA = """
architectures:
  camera_navigator:
    function: navigation
    quality: 80%
    components: {eye: {cpu: 20%}}
  talker:
    function: talking
    components: {voice: {cpu: 20%}}
"""


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a function that writes a file, and returns where it is."""

    def write_text(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
        return path

    return write_text


@pytest.fixture
def install(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, str], None]:
    """Return a function that installs a package with architecture files."""

    def install_package(module: str, text: str) -> None:
        write(f"site/{module}/__init__.py", "raise RuntimeError('imported')")
        write(f"site/{module}/architectures/all.yaml", text)
        info = f"site/{module}-1.2.dist-info"
        write(
            f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.2"
        )
        path = write(
            f"{info}/entry_points.txt",
            f"[poise.architectures]\n{module} = {module}.architectures\n",
        )
        monkeypatch.syspath_prepend(path.parents[1])

    return install_package


def problems_of(path: Path) -> tuple[FileProblem, ...]:
    with pytest.raises(RobotError) as caught:
        load(path)
    return caught.value.problems


def names(path: Path) -> list[str]:
    return [architecture.name for architecture in load(path).architectures]


def test_takes_every_architecture_whose_function_a_task_names(write: Write) -> None:
    """Two provide navigation; nobody asks for talking."""
    write("parts/laser.yaml", LASER)
    camera = write("parts/camera.yml", CAMERA)
    robot = load(write("robot.yaml", ROBOT))
    assert [a.name for a in robot.architectures] == [
        "camera_navigator",
        "laser_navigator",
    ]
    assert robot.architectures[0].file == str(camera)
    assert robot.repository == (str(camera.parent),)


def test_joins_the_robots_own_alternatives(write: Write) -> None:
    """Folders that the file names add to what it has."""
    write("parts/camera.yaml", CAMERA)
    assert names(write("robot.yaml", ROBOT + LASER)) == [
        "laser_navigator",
        "camera_navigator",
    ]


def test_tells_problems_where_they_are_in_the_architectures_file(write: Write) -> None:
    """A key, and a name that only the robot shows to be wrong."""
    bad = write("parts/laser.yaml", LASER.replace("cpu", "cpus"))
    (problem,) = [p for p in problems_of(write("robot.yaml", ROBOT)) if p.line == 5]
    assert (problem.file, problem.column) == (str(bad), 28)
    assert "did you mean 'cpu'" in problem.message
    bad = write("parts/laser.yaml", LASER.replace("cpu: 10%", "devices: [laser]"))
    (problem,) = problems_of(write("robot.yaml", ROBOT))
    assert (problem.file, problem.line, problem.column) == (str(bad), 5, 38)
    assert "there is no device 'laser'" in problem.message


def test_says_where_a_function_was_searched(write: Write) -> None:
    """The name, the nearest one, the folder, and that no package has any."""
    parts = write("parts/laser.yaml", LASER).parent
    robot = write("robot.yaml", ROBOT.replace("[navigation]", "[navigaton]"))
    (problem,) = problems_of(robot)
    assert (problem.file, problem.line) == (str(robot), 5)
    assert "no function 'navigaton' (did you mean 'navigation'?)" in problem.message
    assert f"searched: the robot file, {parts} (1 architecture)" in problem.message
    assert "installed packages (none" in problem.message


def test_refuses_a_folder_that_is_not_there(write: Write, tmp_path: Path) -> None:
    """It is told where it is named, whatever the name."""
    for name in ("parts", "x" * 300):
        text = ROBOT.replace("[parts]", f"[{name}]")
        problems = problems_of(write("robot.yaml", text))
        assert (problems[0].line, problems[0].column) == (3, 14)
        assert f"the folder '{tmp_path}/{name}' cannot be read: " in str(problems[0])


def test_the_robots_own_architecture_hides_one_of_its_name(write: Write) -> None:
    """So one can be changed without its file."""
    write("parts/laser.yaml", LASER.replace("10%", "90%"))
    robot = write("robot.yaml", ROBOT + LASER)
    source = load_source(robot)
    assert [c.demand for c in source.robot.components()] == [{"cpu": 0.1}]
    assert "hidden by that of the robot file" in source.repository.offers[0].unused


def test_refuses_a_name_twice_in_one_folder(write: Write) -> None:
    """Nobody could say which one is meant."""
    write("parts/a.yaml", LASER)
    write("parts/b.yaml", LASER)
    (problem,) = problems_of(write("robot.yaml", ROBOT))
    assert problem.file.endswith("b.yaml")
    assert "laser_navigator is defined twice" in problem.message


def test_passes_over_what_needs_a_device_that_the_robot_lacks(write: Write) -> None:
    """Another one provides the function; it is said which is passed over, and why."""
    write("parts/laser.yaml", LASER.replace("cpu: 10%", "devices: [laser]"))
    write("parts/camera.yaml", CAMERA)
    source = load_source(write("robot.yaml", ROBOT))
    assert [a.name for a in source.robot.architectures] == ["camera_navigator"]
    (sentence,) = source.repository.passed_over
    assert "'laser_navigator'" in sentence
    assert "no device 'laser'" in sentence


def test_folders_are_relative_to_the_file_that_names_them(write: Write) -> None:
    """Also that of an included file; a robot file beside is no architecture file."""
    write("robots/base.yaml", "repository: [../parts]\n")
    write("parts/other.yaml", "robot: other\n")
    write("parts/laser.yaml", LASER)
    text = ROBOT.replace("repository: [parts]", "include: [robots/base.yaml]")
    assert names(write("robot.yaml", text)) == ["laser_navigator"]


def test_finds_architectures_in_installed_packages(
    write: Write, install: Callable[[str, str], None]
) -> None:
    """Without importing them."""
    install("courier_nav", LASER)
    robot = load(write("robot.yaml", ROBOT.replace("repository: [parts]", "")))
    assert [(a.name, a.package) for a in robot.architectures] == [
        ("laser_navigator", "courier_nav 1.2")
    ]


def test_what_is_installed_does_not_change_a_complete_robot(
    write: Write, install: Callable[[str, str], None]
) -> None:
    """A function that the file provides is not looked for in packages."""
    install("courier_nav", CAMERA)
    text = ROBOT.replace("repository: [parts]", "") + LASER
    assert names(write("robot.yaml", text)) == ["laser_navigator"]


def test_refuses_an_entry_point_that_names_no_package(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package and its entry point are named."""
    info = "site/broken-3.dist-info"
    write(f"{info}/METADATA", "Metadata-Version: 2.1\nName: broken\nVersion: 3")
    text = "[poise.architectures]\nparts = broken_nowhere.parts\n"
    monkeypatch.syspath_prepend(write(f"{info}/entry_points.txt", text).parents[1])
    write("parts/laser.yaml", LASER)
    (problem,) = problems_of(write("robot.yaml", ROBOT))
    assert problem.file == "package broken 3"
    assert "'broken_nowhere.parts', which is no Python package" in problem.message
