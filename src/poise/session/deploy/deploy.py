"""Sends a robot's code to its computers, and sees which of them have it.

With it go the wheels of its `requirements.txt`, for each platform of its computers.
They are chosen once, and written with their hashes into `requirements.lock` beside it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from poise.clock import SystemClock
from poise.decoding import from_json
from poise.errors import RunError, UsageError
from poise.estimate.code_version import files_of, files_of_modules
from poise.manage.agent_connections.reports import AgentReports
from poise.manage.agent_connections.requests import AgentRequests
from poise.model.robot import Robot
from poise.session import Check, Say, log, nothing
from poise.session.arguments import check_robot
from poise.session.deploy.native_code import unfit
from poise.session.folders import write_whole
from poise.session.launch.computers import Computers, real_agents
from poise.units import format_bytes
from poise.user_folders import home_folder
from poise.wire.codec import MALFORMED
from poise.wire.control_session import close_session, open_session
from poise.wire.records.code_records import (
    CODE,
    MANIFEST,
    SHOWN,
    CodePart,
    CodeReceived,
    InstallCode,
    Manifest,
)
from poise.wire.records.request_records import Accepted, Answer, Refused, Request


def version_of(archive: bytes) -> str:
    """Return an archive's version: its SHA-256, in hexadecimal digits."""
    return hashlib.sha256(archive).hexdigest()


def pack(robot: Robot, manifest: Manifest) -> bytes:
    """Return the archive of what a robot's components and policies are made of.

    Of modules in packages it has the whole package; of commands, the program and the
    arguments that are files. UsageError: nothing of it is in the robot's folders.
    """
    files = _files(robot)
    if not files:
        raise UsageError(
            f"there is no code of robot '{robot.name}' in "
            f"{', '.join(robot.folders)}: what is installed on each computer needs no "
            "deployment"
        )
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as tar:
        _add(tar, MANIFEST, msgspec.json.encode(manifest, order="deterministic"))
        for name, path in sorted(files.items()):
            is_program = bool(path.stat().st_mode & 0o100)
            _add(tar, f"{CODE}/{name}", path.read_bytes(), is_program=is_program)
    return packed.getvalue()


def _files(robot: Robot) -> Mapping[str, Path]:
    """Return what is packed, by its name; of two, the first folder's counts."""
    folders = [Path(folder) for folder in robot.folders]
    calls = [p.call.partition(":")[0] for p in robot.policies if p.call]
    reached = files_of_modules(calls, folders)
    for component in robot.components():
        reached |= files_of(component, robot.folders)
    files: dict[str, Path] = {}
    for number, path in sorted(reached):
        folder = folders[number]
        if _is_own(path, folder):
            for file in _with_package(path, folder):
                files.setdefault(str(file.relative_to(folder)), file)
    return files


def _is_own(path: Path, folder: Path) -> bool:
    """Return whether a file is the robot's: any module is, no installed program."""
    if not path.is_relative_to(folder) or ".." in path.relative_to(folder).parts:
        return False
    is_module = path.suffix in {".py", ".so"}
    return is_module or path.resolve().is_relative_to(folder.resolve())


def _with_package(file: Path, folder: Path) -> Iterator[Path]:
    """Yield a file, or all files of the package that it is in."""
    top = folder / file.relative_to(folder).parts[0]
    if not (top / "__init__.py").exists():
        yield file
        return
    for path in top.rglob("*"):
        parts = path.relative_to(folder).parts
        is_hidden = any(part.startswith(".") or part == "__pycache__" for part in parts)
        if path.is_file() and not is_hidden and path.suffix != ".pyc":
            yield path


def _add(
    tar: tarfile.TarFile, name: str, content: bytes, *, is_program: bool = False
) -> None:
    """Add a file whose owner, time and other rights are always the same."""
    member = tarfile.TarInfo(name)
    member.size = len(content)
    member.mode = 0o755 if is_program else 0o644
    tar.addfile(member, io.BytesIO(content))


REACH_LIMIT = 5.0
"""Agents are reached within this time [s]."""
_FIRST_LIMIT = 2.0
_OTHERS_LIMIT = 0.5
"""To see what is there: the first agent, and all others after that [s]."""
_PART = 256 << 10
_PART_LIMIT = 15.0
"""A part is sent and stored within this time [s]."""
_INSTALL_LIMIT = 300.0


class Deployed(Struct, frozen=True, kw_only=True):
    """The version of the code that a robot's computers have now."""

    robot: str
    version: str  # The SHA-256 of its archive
    size: int  # Of the archive [bytes]
    # Computer -> how much was sent to it, with wheels [bytes]; 0: it had all of it
    sent: Mapping[str, int]

    def __str__(self) -> str:
        """Return what was done, for people."""
        to = ", ".join(
            f"{name} ({format_bytes(sent) if sent else 'had it'})"
            for name, sent in self.sent.items()
        )
        return f"version {self.version[:SHOWN]} of robot '{self.robot}' is on {to}"


def deploy(robot: Robot, *, say: Say = log.info, check: Check = nothing) -> Deployed:
    """Send a robot's code to its computers, beside what is there.

    Nothing that runs changes by it: the next `up` runs it, or `Running.replace`.

    Parameters
    ----------
    say
        Takes a sentence for each computer.
    check
        Called several times a second; may raise `KeyboardInterrupt`.

    Raises
    ------
    UsageError
        It has no computers with addresses, or no code of its own.
    RunError
        A computer is out of reach, has no room, or refuses it. The others have it, and
        on that one nothing has changed. Or pip cannot fetch the wheels.
    """
    check_robot(robot)
    with _agents(robot) as (reports, requests, computers):
        names = [computer.name for computer in robot.hosts if computer.address]
        wanted = frozenset(names)
        if not reports.wait_news(lambda: wanted <= reports.reached(), REACH_LIMIT):
            missing = sorted(wanted - reports.reached())
            why = computers.why_silent(missing)
            raise RunError(
                "nothing was sent: out of reach within "
                f"{REACH_LIMIT:g} s: "
                f"{', '.join(f'{n} ({w})' if w else n for n, w in why.items())}"
            )
        statuses = reports.statuses()
        platforms = {name: statuses[name].platform for name in names}
        for sentence in unfit(_files(robot), platforms):
            say(sentence)
        manifest = lock_wheels(robot.folder, set(platforms.values()))
        archive = pack(robot, manifest)
        version = version_of(archive)
        sent, failures = {}, []
        for name in names:
            try:
                files = {}
                if version not in statuses[name].code:
                    wheels = files_for(manifest, platforms[name])
                    files = {d: path.read_bytes() for d, path in wheels.items()}
                    files[version] = archive
                # also where it is: it is the last one deployed then
                sent[name] = _Sending(requests, name, files, check).send(version)
            except RunError as error:
                failures.append(str(error))
            else:
                say(f"{name} has version {version[:SHOWN]}")
    if failures:
        raise RunError("; ".join(failures))
    return Deployed(robot=robot.name, version=version, size=len(archive), sent=sent)


def as_deployed(robot: Robot) -> Robot:
    """Return a robot that runs its deployed code, if its computers run such code.

    Without agents that have deployed code, all import it from the robot file's folder.
    UsageError: the code was changed since it was deployed, or some computers lack it.
    """
    if robot.is_emulated:
        return robot
    with _agents(robot) as (reports, _, _):
        names = {computer.name for computer in robot.hosts if computer.address}
        reports.wait_news(lambda: bool(reports.reached()), _FIRST_LIMIT)
        reports.wait_news(lambda: names <= reports.reached(), _OTHERS_LIMIT)
        there = {n: s.code for n, s in reports.statuses().items() if n in names}
    if not any(there.values()):
        return robot
    version = version_of(pack(robot, manifest_of(robot.folder)))
    lacking = sorted(
        name for name, versions in there.items() if version not in versions
    )
    if lacking:
        raise UsageError(
            f"version {version[:SHOWN]} of robot '{robot.name}', its code as it is "
            f"here, is not on {', '.join(lacking)}: run `poise deploy FILE`"
        )
    return replace(robot, deployed=version)


@contextlib.contextmanager
def _agents(robot: Robot) -> Iterator[tuple[AgentReports, AgentRequests, Computers]]:
    """Reach the agents of a robot's own computers; they may have a manager."""
    if robot.is_emulated:
        raise UsageError(
            f"robot '{robot.name}' has no computer with an `address`: emulated ones "
            "import its code from where it is"
        )
    addresses = real_agents(robot)
    clock = SystemClock()
    session = open_session(
        connect=tuple(addresses.endpoints.values()), keys=addresses.credentials()
    )
    try:
        reports = AgentReports(robot.name, addresses.endpoints, clock)
        kept = reports.subscribe(session)
        requests = AgentRequests(session, f"poise/{robot.name}", reports, clock, {})
        yield reports, requests, Computers(addresses)
        del kept
    finally:
        close_session(session)


class _Sending:
    """Sends files to a computer; `files`: their contents by their SHA-256."""

    def __init__(
        self,
        requests: AgentRequests,
        computer: str,
        files: Mapping[str, bytes],
        check: Check,
    ) -> None:
        self._requests = requests
        self._computer = computer
        self._files = files
        self._check = check
        self._there = 0

    def send(self, version: str) -> int:
        """Return how much was sent [bytes], without what was there before."""
        sent = sum(self._send(digest, data) for digest, data in self._files.items())
        self._ask(InstallCode(version), _INSTALL_LIMIT)
        return sent

    def _send(self, digest: str, content: bytes) -> int:
        before, at, sent = self._there, 0, 0
        while at < len(content):
            data = content[at : at + _PART]
            answer = self._ask(
                CodePart(file=digest, size=len(content), offset=at, data=data),
                _PART_LIMIT,
            )
            assert isinstance(answer, CodeReceived)  # noqa: S101, else it was refused
            sent += len(data) if answer.size == at + len(data) else 0
            at = answer.size
            self._there = before + at
        return sent

    def _ask(self, request: Request, limit: float) -> Answer:
        asked = {self._computer: (self._computer, request, limit)}
        answer = dict(self._requests.answers(asked, self._check))[self._computer]
        if isinstance(answer, Accepted | CodeReceived):
            return answer
        why = f"did not answer within {limit:g} s: deploy again once it is reached"
        if answer is not None:
            why = f"refused: {answer.reason if isinstance(answer, Refused) else answer}"
        size = format_bytes(sum(map(len, self._files.values())))
        raise RunError(
            f"'{self._computer}' has {format_bytes(self._there)} of {size}, and runs "
            f"what it ran: its agent {why}"
        )


REQUIREMENTS, LOCK = "requirements.txt", "requirements.lock"
_LIMIT = 600.0
"""pip fetches the wheels of one platform within this time [s]."""
_OLDEST = 17
"""The C library (2.17) that the oldest wheels still in use were built for."""


class _Lock(msgspec.Struct, frozen=True, kw_only=True):
    requirements: str  # The SHA-256 of `REQUIREMENTS` that it is for
    wheels: Mapping[str, Mapping[str, str]]  # As in `Manifest`


def manifest_of(folder: str) -> Manifest:
    """Return the wheels that are locked for a robot; UsageError: they are not."""
    requirements = Path(folder, REQUIREMENTS)
    if not requirements.exists():
        return Manifest()
    wheels = _locked(requirements)
    if not wheels:
        raise UsageError(
            f"{requirements} was written or changed since {LOCK}: run `poise deploy "
            "FILE`, which locks its wheels"
        )
    return Manifest(wheels=wheels)


def lock_wheels(folder: str, platforms: Collection[str]) -> Manifest:
    """Choose wheels for platforms that have none; return all that is locked."""
    requirements = Path(folder, REQUIREMENTS)
    if not requirements.exists():
        return Manifest()
    wheels = dict(_locked(requirements))
    new = sorted(set(platforms) - wheels.keys())
    for platform in new:
        wheels[platform] = _fetch(requirements, platform)
    if new:
        lock = _Lock(requirements=_digest(requirements), wheels=wheels)
        text = msgspec.json.format(msgspec.json.encode(lock, order="deterministic"))
        write_whole(requirements.with_name(LOCK), f"{text.decode()}\n")
    return Manifest(wheels=wheels)


def files_for(manifest: Manifest, platform: str) -> dict[str, Path]:
    """Return the wheels for a platform by their SHA-256, fetched again if need be."""
    wheels = manifest.wheels.get(platform, {})
    if not all(map(_is_cached, wheels.values())):
        with tempfile.TemporaryDirectory() as folder:
            pinned = Path(folder, REQUIREMENTS)
            pinned.write_text("\n".join(_pins(wheels)))
            _fetch(pinned, platform, "--no-deps", "--require-hashes")
    return {digest: _cached(digest) for digest in wheels.values()}


def _pins(wheels: Mapping[str, str]) -> Iterator[str]:
    for wheel, digest in wheels.items():
        name, version, *_ = wheel.split("-")
        yield f"{name}=={version} --hash=sha256:{digest}"


def _locked(requirements: Path) -> Mapping[str, Mapping[str, str]]:
    """Return the wheels of the lock; none: it is missing, or for other requirements."""
    path = requirements.with_name(LOCK)
    if not path.exists():
        return {}
    try:
        lock = from_json(path.read_bytes(), _Lock)
    except MALFORMED as error:
        raise UsageError(f"{path} is damaged ({error}): remove it") from error
    return lock.wheels if lock.requirements == _digest(requirements) else {}


def _fetch(requirements: Path, platform: str, *options: str) -> dict[str, str]:
    """Fetch wheels into the cache; return the SHA-256 of each, by its name."""
    with tempfile.TemporaryDirectory() as folder:
        argv = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input"]
        argv += ["--disable-pip-version-check", "--only-binary", ":all:", *options]
        argv += [*_target(platform), "--dest", folder, "-r", str(requirements)]
        try:
            done = subprocess.run(  # noqa: S603, our own Python
                argv, capture_output=True, timeout=_LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            raise RunError(
                f"pip did not fetch the wheels for {platform} within {_LIMIT:g} s"
            ) from None
        if done.returncode:
            raise RunError(
                f"pip cannot fetch the wheels of {requirements} for {platform}: "
                f"{done.stderr.decode(errors='replace').strip()}"
            )
        wheels = {path.name: _digest(path) for path in sorted(Path(folder).iterdir())}
        for name, digest in wheels.items():
            _cached(digest).parent.mkdir(parents=True, exist_ok=True)
            shutil.move(Path(folder, name), _cached(digest))
    return wheels


def _target(platform: str) -> list[str]:
    """Return pip's options for a platform, as in `AgentStatus`."""
    machine, python, *library = platform.split()
    names = [f"linux_{machine}", f"manylinux2014_{machine}"]
    if library:
        newest = int(library[0].split(".")[1])
        names += [
            f"manylinux_2_{minor}_{machine}" for minor in range(newest, _OLDEST - 1, -1)
        ]
    options = ["--python-version", python, "--implementation", "cp"]
    return [*options, *(word for name in names for word in ("--platform", name))]


def _cached(digest: str) -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or home_folder() / ".cache"
    return Path(cache, "poise", "wheels", f"{digest}.whl")


def _is_cached(digest: str) -> bool:
    """Return whether a wheel is there, and whole: a copy may have been cut short."""
    path = _cached(digest)
    return path.exists() and _digest(path) == digest


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
