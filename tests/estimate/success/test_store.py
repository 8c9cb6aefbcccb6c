"""Outcomes are kept by robot, action, conditions and hash, until they are reset."""

import contextlib
import sqlite3
from pathlib import Path

import msgspec
import pytest

from poise.errors import UsageError
from poise.estimate.success import Conditions, Outcome, Posterior, SuccessStore

WELL = Conditions()
DRIVEN = Outcome(
    at=0.0,
    action="drive",
    function="navigation",
    architecture="laser",
    hash="1a",
    ending="done",
)


def test_counts_outcomes_apart(tmp_path: Path) -> None:
    """By action, conditions and hash; another robot's are not seen."""
    lost = Conditions(lost=("vision",), cpu_is_short=True)
    with SuccessStore(tmp_path / "new" / "success.sqlite") as store:
        store.add("courier", DRIVEN)
        store.add("courier", DRIVEN)
        store.add("courier", msgspec.structs.replace(DRIVEN, ending="failed"))
        store.add("courier", msgspec.structs.replace(DRIVEN, conditions=lost))
        store.add("other", DRIVEN)
    with SuccessStore(tmp_path / "new" / "success.sqlite") as store:
        assert store.posteriors("courier", "laser") == {
            ("drive", WELL, "1a"): Posterior(done=2, failed=1),
            ("drive", lost, "1a"): Posterior(done=1),
        }


def test_resets_one_architecture(tmp_path: Path) -> None:
    """Others keep theirs."""
    with SuccessStore(tmp_path / "success.sqlite") as store:
        store.add("courier", DRIVEN)
        store.add("courier", msgspec.structs.replace(DRIVEN, architecture="camera"))
        assert store.reset("courier", "laser") == 1
        assert store.posteriors("courier", "laser") == {}
        assert len(store.posteriors("courier", "camera")) == 1


def test_refuses_what_is_no_store(tmp_path: Path) -> None:
    """The file is named."""
    path = tmp_path / "success.sqlite"
    path.write_text("no database, but long enough to look at" * 10)
    with pytest.raises(UsageError, match=r"success\.sqlite cannot store outcomes"):
        SuccessStore(path)


def test_says_which_file_broke_meanwhile(tmp_path: Path) -> None:
    """And what to do about it."""
    path = tmp_path / "success.sqlite"
    with SuccessStore(path) as store:
        with contextlib.closing(sqlite3.connect(path)) as other:
            other.execute("DROP TABLE outcomes")
        with pytest.raises(UsageError, match=r"success\.sqlite .* remove it"):
            store.add("courier", DRIVEN)


def test_the_order_of_lost_computers_means_nothing() -> None:
    """They are a set."""
    assert Conditions(lost=("b", "a", "b")) == Conditions(lost=("a", "b"))
    assert str(Conditions(lost=("b", "a"))) == "without a, b"
