"""Where cgroups are."""

from __future__ import annotations

from pathlib import Path

from poise.kernel_counters import mounts, table


def test_both_versions_are_found_with_the_own_folder(tmp_path: Path) -> None:
    cpu, unified = tmp_path / "cpu,cpuacct", tmp_path / "unified"
    (cpu / "me").mkdir(parents=True)
    unified.mkdir()
    (unified / "cgroup.controllers").write_text("pids\n")
    info, cgroup = tmp_path / "mountinfo", tmp_path / "cgroup"
    info.write_text(
        "23 1 254:0 / / rw - ext4 /dev/vda rw\n"
        f"32 31 0:29 / {cpu} rw,relatime - cgroup cgroup rw,cpu,cpuacct\n"
        f"41 31 0:38 / {unified} rw,relatime shared:4 - cgroup2 cgroup2 rw\n"
    )
    # The unified path is the host's, as in a container, and is not there.
    cgroup.write_text("2:cpu,cpuacct:/me\n0::/somewhere/else\n")
    first, second = mounts(info, cgroup)
    assert (first.version, first.top, first.own) == (1, cpu, cpu / "me")
    assert {"cpu", "cpuacct"} <= first.controllers
    assert (second.version, second.own) == (2, unified)
    assert second.controllers == {"pids"}


def test_table_reads_names_and_numbers() -> None:
    assert table("nr_periods 3\nnr_throttled 1\n") == {
        "nr_periods": 3,
        "nr_throttled": 1,
    }
