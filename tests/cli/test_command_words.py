"""A second word that is neither a command nor a file is named, with the choices."""

from pathlib import Path

import pytest

from poise.cli.command_table import check_words
from poise.errors import UsageError


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("emulate cutt left", "no command 'emulate cutt' (did you mean 'cut'?)"),
        ("task strt fetch", "commands: 'start', 'pause', 'resume'"),
        ("repository lst", "no file 'lst'"),
    ],
)
def test_an_unknown_command_is_named(words: str, said: str) -> None:
    with pytest.raises(UsageError) as error:
        check_words(words.split())
    assert said in str(error.value)


@pytest.mark.parametrize(
    "words",
    ["", "plan", "emulate", "emulate cut a", "emulate robot.yaml", "task list", "up a"],
)
def test_commands_and_files_are_let_through(words: str) -> None:
    check_words(words.split())


def test_a_file_without_a_suffix_is_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("robot").touch()
    check_words(["emulate", "robot"])
