"""The emulations of this user on this machine: all that each makes, on disk.

An emulation is registered before anything of it is made. A killed run cannot clean up;
the next run finds the entry, sees that its owner is dead, and removes what it lists.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from poise.clock import time_of_day
from poise.decoding import from_json
from poise.emulate import cgroups as cgroup_files
from poise.emulate import emulated_network
from poise.emulate.cgroups import Probe
from poise.emulate.emulated_network import NetworkPlan, Shape, plan_network
from poise.emulate.limits import Limits, share_out
from poise.emulate.processes import PREFIX, Owner, marked, stop
from poise.errors import PoiseError, RunError, UsageError
from poise.model.robot import Robot
from poise.threads import poll_until
from poise.user_folders import write_private

FOLDER = "POISE_EMULATIONS"
"""The environment variable that names the registry's folder."""
_LOCK = "emulations.lock"
_LOCK_LIMIT = 30.0


def registry() -> Path:
    """Return the folder of all entries; only this user may write to it.

    `FOLDER` names it where a program has a network namespace of its own: a registry
    keeps apart the addresses of one network.
    """
    run = "/run" if os.access("/run", os.W_OK) else os.environ.get("XDG_RUNTIME_DIR")
    usual = f"{run}/{PREFIX}" if run else f"/tmp/{PREFIX}-{os.getuid()}"  # noqa: S108 - owner and mode are checked below
    folder = Path(os.environ.get(FOLDER) or usual)
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        owner = folder.lstat()
    except OSError as error:
        raise RunError(
            f"there is no list of emulated computers ({error}): set XDG_RUNTIME_DIR, "
            f"or {FOLDER}, to a folder of yours"
        ) from error
    if owner.st_uid != os.getuid() or owner.st_mode & 0o022 or folder.is_symlink():
        message = f"{folder} must belong to user {os.getuid()} alone: remove it"
        raise RunError(message)
    return folder


def registered() -> Iterator[EmulationLayout]:
    """Yield all emulations, of living owners and of dead ones."""
    for file in sorted(registry().glob("*.emulation")):
        try:
            yield from_json(file.read_bytes(), EmulationLayout)
        except FileNotFoundError:  # another process removed it
            continue
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            message = f"{file}: {error}: sweep with the Poise that wrote it, or remove"
            raise RunError(message) from error


@contextmanager
def locked() -> Iterator[None]:
    """Let no other process of this user change kept sets meanwhile."""
    # A manager locks the folder itself, which may be its folder, too.
    file = registry() / _LOCK
    try:
        handle = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        message = f"emulated computers cannot be changed: {error}"
        raise RunError(message) from error
    try:
        late = (
            "another command has been changing emulated computers for "
            f"{_LOCK_LIMIT:g} s: `lsof {file}` names its process"
        )
        poll_until(lambda: _is_locked(handle), time.monotonic() + _LOCK_LIMIT, late)
        yield
    finally:
        os.close(handle)


def register(lay_out: Callable[[Collection[str]], EmulationLayout]) -> EmulationLayout:
    """Lay an emulation out, and write it down, so that `sweep` can find it."""
    with locked():
        others = [computer.address for o in registered() for computer in o.computers]
        layout = lay_out(others)
        if layout.kept is not None:
            _raise_if_kept(layout.kept.robot, layout.run)
        write(layout)
    return layout


def read(run: str) -> EmulationLayout | None:
    """Return an emulation by its name; None when it has ended."""
    return next((layout for layout in registered() if layout.run == run), None)


def write(layout: EmulationLayout) -> None:
    """Write an entry, or what has changed in it."""
    try:
        write_private(_entry(layout.run), msgspec.json.encode(layout))
    except OSError as error:
        raise RunError(f"an emulation cannot be written down: {error}") from error


def _remove_folder(folder: str) -> None:
    """Remove a folder with all in it; another process may do so at the same time."""
    while Path(folder).is_dir():
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder)


def remove(layout: EmulationLayout) -> None:
    """Remove all of an emulation, and then its entry. Repeating it is harmless."""
    network, computers = layout.network, layout.computers
    steps: tuple[tuple[Callable[[str], None], Iterable[str]], ...] = (
        (_end_marked, [computer.mark for computer in computers]),
        (cgroup_files.remove, [folder for c in computers for folder in c.groups]),
        (cgroup_files.bring_back, layout.aside),
        (emulated_network.unplug, [network.owner] if network else []),
        (emulated_network.remove, network.namespaces if network else []),
        (_remove_folder, [computer.folder for computer in computers]),
    )
    problems: list[str] = []
    for act, things in steps:
        for thing in things:
            try:
                act(thing)
            except (OSError, PoiseError) as error:
                problems.append(f"{thing}: {error}")
    if problems:
        message = "an emulation could not remove: " + "; ".join(problems)
        raise RunError(message)
    with locked():  # or a command that changes the entry would bring it back
        _entry(layout.run).unlink(missing_ok=True)


def sweep() -> list[Owner]:
    """Remove emulations whose owner is dead; return those owners."""
    dead = [layout for layout in registered() if not layout.owner.is_alive()]
    return [layout.owner for layout in dead if _sweep(layout)]


def _raise_if_kept(robot: str, run: str) -> None:
    for other in registered():
        is_kept = other.kept is not None and other.kept.robot == robot
        if is_kept and other.run != run and other.owner.is_alive():
            raise UsageError(
                f"robot '{robot}' has emulated computers already, of process "
                f"{other.owner.pid}: `poise emulate stop --robot {robot}` ends them"
            )


def _is_locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _sweep(layout: EmulationLayout) -> bool:
    """Remove an emulation, unless another process does."""
    try:
        with _entry(layout.run).open("rb") as handle:
            # The lock is held during the work; another sweep then skips this entry.
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            remove(layout)
    except (FileNotFoundError, BlockingIOError):
        return False
    return True


def _end_marked(mark: str) -> None:
    stop(lambda: marked(mark), ask=0.0)


def _entry(run: str) -> Path:
    return registry() / f"{run}.emulation"


FaultKind = Literal["cut", "slow", "crashed", "frozen", "frozen agent", "load"]


class InjectedFault(Struct, frozen=True, kw_only=True):
    """A fault that any process injected, in force until it is healed."""

    kind: FaultKind
    on: tuple[str, ...]  # the computer, or the two computers of a link
    since: float  # [s since 1970]
    shape: Shape | None = None  # of a slow link
    cpu: float | None = None  # of a load [host cores]
    processes: tuple[int, ...] = ()  # of a load: their numbers

    def __str__(self) -> str:
        since = time_of_day(self.since)
        what = f"{self.kind} {' '.join(self.on)}"
        if self.cpu is not None:
            what += f" of {self.cpu:g} cores"
        if self.shape is not None and self.shape.bandwidth is not None:
            what += f" to {self.shape.bandwidth * 8e-6:g} Mbit/s"
        if self.shape is not None and self.shape.latency:
            what += f" with {self.shape.latency * 1e3:g} ms"
        return f"{what} since {since}"

    @property
    def way_out(self) -> str:
        """What ends it, for people."""
        on = " ".join(self.on)
        if self.kind == "load":
            return f"`poise emulate load {on} --cpu 0` ends it"
        verb = "heal" if self.kind in {"cut", "slow"} else "boot"
        return f"`poise emulate {verb} {on}` ends it"


class ComputerLayout(Struct, frozen=True, kw_only=True):
    """The layout of one computer."""

    name: str
    mark: str  # names its group; its processes inherit it
    address: str  # the IP address at which its processes listen
    folder: str  # its private folder
    limits: Limits
    homes: Mapping[str, str] = {}  # cgroup controller -> its folder there
    namespace: str | None = None  # its network namespace; None: the owner's
    pin: bool = False  # whether ``taskset`` gives its processes their CPUs
    has_quota: bool = False  # whether its quota is enforced

    @property
    def groups(self) -> tuple[str, ...]:
        """Its cgroup folders."""
        return tuple(dict.fromkeys(self.homes.values()))


class KeptSet(Struct, frozen=True, kw_only=True):
    """What others must know of an emulation that is kept for them."""

    robot: str  # its name
    # the robot's computers and links, to compare with those of a robot file
    hardware: str
    since: float | None = None  # when it was up [s since 1970]; None: it is not yet
    without: tuple[str, ...] = ()  # `Emulation.without`
    no_network: str = ""  # why there is no emulated network; empty: there is one
    faults: tuple[InjectedFault, ...] = ()  # the injected ones that are in force

    @classmethod
    def of(cls, robot: Robot) -> KeptSet:
        """Return what is known of a robot's emulation before it is up."""
        return cls(robot=robot.name, hardware=repr((robot.computers, robot.links)))


class EmulationLayout(Struct, frozen=True, kw_only=True):
    """The whole emulation."""

    owner: Owner
    run: str  # its name; unique on this machine
    computers: tuple[ComputerLayout, ...] = ()
    network: NetworkPlan | None = None  # none where there are no namespaces
    # cgroup folders with processes that were in the way; they go back at the end
    aside: tuple[str, ...] = ()
    kept: KeptSet | None = None  # none: only the owner uses it


def lay_out(
    robot: Robot,
    folder: Path,
    host: Probe,
    number: int,
    kept: KeptSet | None = None,
    taken: Collection[str] = (),
) -> EmulationLayout:
    """Return the layout of the computers of `robot` on `host`."""
    owner = Owner.this()
    run = f"{owner}-{number}"
    names = [computer.name for computer in robot.computers]
    limits = share_out(robot.computers, host.cpus)
    network = None
    if host.has_namespaces:
        network = plan_network(owner, number, names, robot.links, taken)
    loopback = _loopback(owner.pid + number, taken)
    computers = []
    for index, name in enumerate(names):
        cable = network.cables[index] if network else None
        computers.append(
            ComputerLayout(
                name=name,
                mark=f"{run}-{index}",
                address=cable.address if cable else f"{loopback}{index}.1",
                folder=_private(folder, name),
                limits=limits[index],
                namespace=cable.namespace if cable else None,
            )
        )
    layout = EmulationLayout(
        owner=owner,
        run=run,
        computers=tuple(computers),
        network=network,
        aside=tuple(map(str, host.groups.aside(run))),
        kept=kept,
    )
    return regrouped(layout, host)


def regrouped(layout: EmulationLayout, host: Probe) -> EmulationLayout:
    """Return a layout with the groups that a host allows."""
    controls = host.groups.controls
    computers = tuple(
        replace(
            computer,
            homes={k: str(v) for k, v in host.groups.homes(computer.mark).items()},
            pin="cpuset" not in controls and "taskset" in host.tools,
            has_quota="cpu" in controls,
        )
        for computer in layout.computers
    )
    return replace(layout, computers=computers)


def _private(folder: Path, name: str) -> str:
    private = folder.absolute() / name
    if private.exists():
        message = f"{private} exists: give each run a folder of its own"
        raise UsageError(message)
    return str(private)


def _loopback(start: int, taken: Collection[str]) -> str:
    """Return how free addresses in 127.0.0.0/8 begin, such as ``127.7.``."""
    begins = [f"127.{1 + (start + step) % 254}." for step in range(254)]
    free = (begin for begin in begins if not any(t.startswith(begin) for t in taken))
    return next(free, begins[0])
