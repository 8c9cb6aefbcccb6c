"""A version of code is on a computer as a whole, or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import subprocess
import tarfile
import tempfile
import threading
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from queue import Queue

import msgspec
import pytest
from hypothesis import given

from poise.errors import RunError
from poise.runtime.agent import code_folder
from poise.runtime.agent.code_folder import (
    CodeFolder,
    this_platform,
    unpack,
    unpack_wheel,
)
from poise.wire.records.code_records import (
    CodePart,
    CodeReceived,
    InstallCode,
    Manifest,
)
from poise.wire.records.request_records import Accepted, Answer, Refused
from tests.wire.test_fuzz import changed, changes


def archive_of(
    *files: tuple[str, bytes], wheels: dict[str, str] | None = None
) -> bytes:
    """Return an archive of code; `wheels`: those for this platform."""
    manifest = Manifest(wheels={this_platform(): wheels} if wheels else {})
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        for name, content in (("manifest.json", msgspec.json.encode(manifest)), *files):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return packed.getvalue()


def with_size(size: str) -> bytes:
    """Return an archive that says so of the size of its file."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        member = tarfile.TarInfo("a.py")
        member.pax_headers = {"GNU.sparse.size": size}
        tar.addfile(member)
    return packed.getvalue()


def digest_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def ask(folder: CodeFolder, request: CodePart | InstallCode) -> Answer:
    answers: list[Answer] = []
    is_done = threading.Event()

    def reply(answer: Answer) -> None:
        answers.append(answer)
        is_done.set()

    folder.serve(request, reply)
    assert is_done.wait(20)
    return answers[0]


def send(folder: CodeFolder, data: bytes, digest: str = "") -> Answer:
    part = CodePart(file=digest or digest_of(data), size=len(data), offset=0, data=data)
    return ask(folder, part)


def install(folder: CodeFolder, data: bytes) -> Answer:
    assert send(folder, data) == CodeReceived(len(data))
    return ask(folder, InstallCode(digest_of(data)))


def refusal(answer: Answer) -> str:
    assert isinstance(answer, Refused)
    return answer.reason


CODE = archive_of(("code/robot.py", b"X = 1\n"))
VERSION = digest_of(CODE)


def test_a_version_is_unpacked_and_nothing_else_stays(tmp_path: Path) -> None:
    folder = CodeFolder(tmp_path / "code")
    assert install(folder, CODE) == Accepted()
    assert folder.versions() == (VERSION,)
    assert (tmp_path / "code" / VERSION / "code/robot.py").read_bytes() == b"X = 1\n"
    assert [path.name for path in (tmp_path / "code").iterdir()] == [VERSION]
    assert (tmp_path / "code").stat().st_mode & 0o77 == 0
    assert CodeFolder(tmp_path / "code").versions() == (VERSION,)


def test_a_program_stays_one_and_nothing_else_becomes_one(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "archive", "w") as tar:
        for name, mode in (("camera", 0o755), ("camera.py", 0o644)):
            member = tarfile.TarInfo(name)
            member.mode = mode
            tar.addfile(member)
    unpack(tmp_path / "archive", tmp_path / "into")
    modes = {p.name: p.stat().st_mode & 0o777 for p in (tmp_path / "into").iterdir()}
    assert modes == {"camera": 0o700, "camera.py": 0o600}


def test_one_request_is_served_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_begun, may_end = threading.Event(), threading.Event()

    def waits(archive: Path, into: Path) -> int:
        has_begun.set()
        assert may_end.wait(20)
        return unpack(archive, into)

    monkeypatch.setattr(code_folder, "unpack", waits)
    folder = CodeFolder(tmp_path)
    send(folder, CODE)
    answers: Queue[Answer] = Queue()
    folder.serve(InstallCode(VERSION), answers.put)
    assert has_begun.wait(20)
    assert "busy with other code" in refusal(send(folder, CODE))
    may_end.set()
    assert answers.get(timeout=20) == Accepted()
    assert send(folder, CODE) == CodeReceived(len(CODE))


def test_an_interrupted_file_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code_folder, "MOST_CODE", len(CODE))  # what came counts once
    folder = CodeFolder(tmp_path)
    first = CodePart(file=VERSION, size=len(CODE), offset=0, data=CODE[:100])
    assert ask(folder, first) == CodeReceived(100)
    assert ask(folder, first) == CodeReceived(100)  # it came twice
    rest = CodePart(file=VERSION, size=len(CODE), offset=100, data=CODE[100:])
    assert ask(folder, rest) == CodeReceived(len(CODE))
    assert ask(folder, InstallCode(VERSION)) == Accepted()


def test_a_killed_agents_left_over_parts_are_removed(tmp_path: Path) -> None:
    folder = CodeFolder(tmp_path)
    part = CodePart(file=VERSION, size=len(CODE), offset=0, data=CODE[:100])
    ask(folder, part)
    half = tmp_path / f"{VERSION}.new" / "code"
    half.mkdir(parents=True)
    again = CodeFolder(tmp_path)
    assert again.versions() == ()
    assert not [*tmp_path.iterdir()]
    assert "was not sent" in refusal(ask(again, InstallCode(VERSION)))


def test_other_bytes_than_announced_are_dropped(tmp_path: Path) -> None:
    folder = CodeFolder(tmp_path)
    assert "send it again" in refusal(send(folder, CODE, "0" * 64))
    more = CodePart(file=VERSION, size=10, offset=0, data=CODE)
    assert "send it again" in refusal(ask(folder, more))
    assert "is no SHA-256" in refusal(send(folder, CODE, "../" + "0" * 61))
    assert folder.versions() == ()
    assert not [*tmp_path.iterdir()]


def test_too_much_code_is_refused_before_it_is_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code_folder, "MOST_CODE", len(CODE) + 5)
    folder = CodeFolder(tmp_path)
    send(folder, CODE)
    assert "of code at once are not stored" in refusal(send(folder, b"123456"))


HOSTILE = {
    "absolute": ("/tmp/evil", tarfile.REGTYPE),
    "outside": ("code/../../evil", tarfile.REGTYPE),
    "symlink": ("code/link", tarfile.SYMTYPE),
    "hard link": ("code/link", tarfile.LNKTYPE),
    "device": ("code/device", tarfile.CHRTYPE),
    "fifo": ("code/fifo", tarfile.FIFOTYPE),
    "folder": ("code/folder", tarfile.DIRTYPE),
    "no name": ("code/a\0b", tarfile.REGTYPE),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_archive_is_refused_and_writes_nothing(
    tmp_path: Path, what: str
) -> None:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        member = tarfile.TarInfo(HOSTILE[what][0])
        member.type, member.linkname = HOSTILE[what][1], "/etc/passwd"
        member.pax_headers = {"path": HOSTILE[what][0]}
        tar.addfile(member, io.BytesIO())
    folder = CodeFolder(tmp_path / "code")
    why = refusal(install(folder, packed.getvalue()))
    assert "is not a plain file" in why or "leads out of its folder" in why
    assert not [*(tmp_path / "code").glob("*.new")]
    assert [path.name for path in tmp_path.iterdir()] == ["code"]
    assert folder.versions() == ()


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"no archive", "this is not an archive of code"),
        (CODE[:700], "this is not an archive of code"),
        (with_size("x"), "this is not an archive of code: invalid literal"),
        (archive_of(("code/a.py", b""), ("code/a.py", b"")), "File exists"),
        (
            archive_of(("code/a.py", b""), wheels={"tiny.whl": "1" * 64}),
            "wheels were not sent: tiny.whl",
        ),
    ],
)
def test_a_wrong_archive_is_refused(tmp_path: Path, data: bytes, why: str) -> None:
    folder = CodeFolder(tmp_path)
    assert why in refusal(install(folder, data))
    assert folder.versions() == ()
    assert not [*tmp_path.glob("*.new")]


def test_an_archive_that_grows_is_bounded(tmp_path: Path) -> None:
    (tmp_path / "a.tar").write_bytes(archive_of(("code/a", bytes(2000))))
    with pytest.raises(RunError, match="of code are not stored"):
        unpack(tmp_path / "a.tar", tmp_path / "into", left=1500)


def test_wheels_are_unpacked_beside_the_code(tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as wheel:
        wheel.writestr("tiny/", "")
        wheel.writestr("tiny/__init__.py", "")
        wheel.writestr("tiny-1.0.data/purelib/small.py", "")
        wheel.writestr("tiny-1.0.data/scripts/run", "")
    digest = digest_of(packed.getvalue())
    folder = CodeFolder(tmp_path)
    send(folder, packed.getvalue())
    code = archive_of(("code/a.py", b""), wheels={"tiny.whl": digest})
    assert install(folder, code) == Accepted()
    packages = tmp_path / digest_of(code) / "packages"
    found = {str(p.relative_to(packages)) for p in packages.rglob("*") if p.is_file()}
    assert found == {"tiny/__init__.py", "small.py"}


def test_of_a_file_that_two_wheels_have_the_last_one_counts(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with zipfile.ZipFile(tmp_path / name, "w") as wheel:
            wheel.writestr("tests/__init__.py", name)
        unpack_wheel(tmp_path / name, tmp_path / "into", left=1000)
    assert (tmp_path / "into/tests/__init__.py").read_text() == "b"


def test_code_is_taken_again_after_no_thread_was_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    folder = CodeFolder(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", fail)
        why = refusal(ask(folder, InstallCode(digest_of(CODE))))
    assert why == "it cannot take code for now: can't start new thread"
    assert install(folder, CODE) == Accepted()


def test_the_last_versions_and_those_in_use_stay(tmp_path: Path) -> None:
    folder = CodeFolder(tmp_path)
    versions = []
    for number in range(6):
        code = archive_of(("code/a.py", b"%d" % number))
        versions.append(digest_of(code))
        install(folder, code)
        os.utime(tmp_path / versions[-1], (number, number))
        folder.keep({versions[0]})
    assert set(folder.versions()) == {versions[0], *versions[3:]}
    assert not (tmp_path / versions[1]).exists()


def test_a_version_that_is_deployed_again_is_the_last_one(tmp_path: Path) -> None:
    folder = CodeFolder(tmp_path)
    codes = [archive_of(("code/a.py", b"%d" % number)) for number in range(4)]
    versions = [digest_of(code) for code in codes]
    for number in range(3):
        install(folder, codes[number])
        os.utime(tmp_path / versions[number], (number, number))
    assert ask(folder, InstallCode(versions[0])) == Accepted()
    assert folder.versions()[0] == versions[0]
    install(folder, codes[3])
    assert set(folder.versions()) == {versions[0], versions[2], versions[3]}


def test_the_last_version_stays_though_the_clock_was_set_back(tmp_path: Path) -> None:
    folder = CodeFolder(tmp_path)
    codes = [archive_of(("code/a.py", b"%d" % number)) for number in range(4)]
    versions = [digest_of(code) for code in codes]
    for number in range(3):
        install(folder, codes[number])
        os.utime(tmp_path / versions[number], (4e9 + number, 4e9 + number))
    assert install(folder, codes[3]) == Accepted()
    assert folder.versions() == (versions[3], versions[2], versions[1])
    assert ask(folder, InstallCode(versions[1])) == Accepted()
    assert folder.versions() == (versions[1], versions[3], versions[2])


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    if os.getuid() != 0:
        pytest.skip("only root mounts a file system")
    place = tmp_path / "disk"
    place.mkdir()
    argv = ["mount", "-t", "tmpfs", "-o", "size=256k", "none", str(place)]
    if subprocess.run(argv, check=False).returncode:
        pytest.skip("no file system can be mounted here")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.slow
def test_a_full_disk_changes_nothing(small_disk: Path) -> None:
    folder = CodeFolder(small_disk)
    assert install(folder, CODE) == Accepted()
    why = refusal(send(folder, archive_of(("code/large", os.urandom(500_000)))))
    assert "No space left on device" in why
    assert f"are free in {small_disk} without it): make room there" in why
    # there is room for the archive, but not to unpack it
    large = archive_of(("code/large", os.urandom(150_000)))
    assert "No space left on device" in refusal(install(folder, large))
    assert folder.versions() == (VERSION,)
    assert not [*small_disk.glob("*.*")]
    assert CodeFolder(small_disk).versions() == (VERSION,)


def packed_wheel() -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as wheel:
        tiny = zipfile.ZipInfo("tiny.py")
        wheel.writestr(tiny, "X = 1\n" * 100, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


@given(changes)
@pytest.mark.parametrize(
    ("whole", "unpack_one"),
    [(CODE, unpack), (packed_wheel(), partial(unpack_wheel, left=10_000_000))],
    ids=["archive", "wheel"],
)
def test_what_was_changed_is_unpacked_or_refused(
    whole: bytes,
    unpack_one: Callable[[Path, Path], int],
    places: list[tuple[int, int]],
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, into = Path(folder, "changed"), Path(folder, "into")
        path.write_bytes(changed(whole, places))
        with contextlib.suppress(RunError, OSError):
            unpack_one(path, into)
        assert {*Path(folder).iterdir()} <= {path, into}
