from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.estimate.profiles import Profile, Store


def test_gives_back_the_newest(tmp_path: Path, profile: Profile) -> None:
    newer = replace(profile, at="2026-02-01T00:00:00+00:00")
    path = tmp_path / "deep" / "profiles.sqlite"
    with Store(path) as store:
        for each in (profile, newer):
            store.add(each)
    with Store(path) as store:
        assert store.all("r") == [newer, profile]
        assert not store.all("another")


def test_keeps_what_connectors_cost(tmp_path: Path, profile: Profile) -> None:
    path = tmp_path / "profiles.sqlite"
    with Store(path) as store:
        assert store.latest_costs("r") == {}
        store.add_costs("r", {})
        store.add_costs("r", profile.costs)
        store.add_costs("another", {})
    with Store(path) as store:
        assert store.latest_costs("r") == profile.costs


def test_what_another_version_wrote_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "profiles.sqlite"
    with Store(path) as store:
        store._add("r", "profile", {"robot": "r"})
        store._add("r", "costs", {"remote": [1]})
    says = r"profiles\.sqlite cannot store .* another version of Poise .* remove it"
    with pytest.raises(UsageError, match=says), Store(path) as store:
        store.all("r")
    with pytest.raises(UsageError, match=says), Store(path) as store:
        store.latest_costs("r")


def test_a_damaged_file_is_not_kept_open(tmp_path: Path) -> None:
    path = tmp_path / "profiles.sqlite"
    path.write_text("no database" * 100)
    with pytest.raises(UsageError, match="is not a database"):
        Store(path)
    opened = [link.resolve() for link in Path("/proc/self/fd").iterdir()]
    assert path not in opened
