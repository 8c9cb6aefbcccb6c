from __future__ import annotations

import csv
from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.session.recorded_run import COLUMNS, Which, export
from tests.manage.observe.conftest import Sampler


def as_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_for_every_component_in_every_sample(
    steady: Sampler, tmp_path: Path
) -> None:
    path = tmp_path / "run.csv"
    assert export([steady(1.0), steady(2.0)], path, "components") == 4
    head, first, *_, last = path.read_text().splitlines()
    assert head == ",".join(COLUMNS["components"])
    assert first == "a,see,eye,0,1.0,0.1,0.0,10,10,0.32,9000000"
    assert last.startswith("a,see,mind,0,2.0,0.4,")


def test_a_row_for_every_end_of_a_connector(steady: Sampler, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    assert export([steady(1.0)], path, "connectors") == 1
    (row,) = as_rows(path)
    assert row["connector"] == "eye.x-mind.x"
    assert (row["messages"], row["bytes_out"], row["errors"]) == ("10", "0", "0")
    assert (row["arrivals"], row["latency_s"], row["latency_error_s"]) == (
        *("10", "0.02", "0.001"),
    )


@pytest.mark.slow
@pytest.mark.parametrize("which", ["components", "connectors"])
def test_parquet_holds_the_same(steady: Sampler, tmp_path: Path, which: Which) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    samples = [steady(0.2 * k) for k in range(50)]
    text, binary = tmp_path / "run.csv", tmp_path / "run.parquet"
    assert export(samples, text, which) == export(samples, binary, which)
    found = parquet.read_table(binary).to_pylist()
    told = [{k: str(v) for k, v in row.items()} for row in found]
    assert told == as_rows(text)


def test_many_rows_are_written_piece_by_piece(
    steady: Sampler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("poise.session.recorded_run._MANY", 3)
    path = tmp_path / "run.parquet"
    assert export([steady(0.2 * k) for k in range(10)], path, "components") == 20
    file = parquet.ParquetFile(path)
    assert (file.metadata.num_rows, file.num_row_groups) == (20, 7)
    file.close()


def test_nothing_recorded_is_an_empty_table(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "run.parquet"
    assert export([], path, "components") == 0
    assert parquet.read_table(path).column_names == list(COLUMNS["components"])


def test_the_name_says_the_format(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ends in \.csv or \.parquet"):
        export([], tmp_path / "run.xls", "components")
