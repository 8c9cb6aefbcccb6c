"""The account that containers run as when their agent is root (`poise agent --run-as`).

The zygote becomes it before it forks any container. The agent stays root, and touches
the folder of its containers with the rights of this account only: otherwise a component
could lead it to other files by a link.
"""

from __future__ import annotations

import ctypes
import os
import pwd
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.priority import let_go_first

_PR_SET_DUMPABLE = 4


class Account(Struct, frozen=True):
    """A user of this computer who is not root."""

    name: str
    user: int
    group: int
    home: str

    @classmethod
    def of(cls, name: str) -> Account:
        """Return a user's account; UsageError: there is none, or none may be taken."""
        try:
            entry = pwd.getpwnam(name)
        except KeyError:
            raise UsageError(
                f"--run-as {name}: this computer has no such user: `useradd --system "
                f"{name}` makes one"
            ) from None
        if not entry.pw_uid:
            raise UsageError(f"--run-as {name}: choose a user who is not root")
        if os.getuid():
            raise UsageError(
                f"--run-as {name}: only an agent that runs as root can do that; "
                "without it, containers run as the agent's user"
            )
        return cls(name, entry.pw_uid, entry.pw_gid, entry.pw_dir)

    def become(self) -> None:
        """Let this process, which has one thread, be this user's for good."""
        let_go_first()
        os.initgroups(self.name, self.group)
        os.setresgid(self.group, self.group, self.group)
        os.setresuid(self.user, self.user, self.user)
        # its files in /proc are root's otherwise, and it could not read its own
        ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 1, 0, 0, 0)
        os.environ.update(HOME=self.home, USER=self.name, LOGNAME=self.name)
        os.environ.pop("XDG_RUNTIME_DIR", None)

    def owns(self, process: int) -> bool:
        """Return whether a process is this user's."""
        try:
            return Path(f"/proc/{process}").stat().st_uid == self.user
        except OSError:
            return False

    def make_folder(self, folder: Path) -> None:
        """Make his own folder in one of root's; UsageError: he does not get there."""
        if folder.parent.stat().st_uid:
            raise UsageError(
                f"--run-as {self.name}: {folder.parent} must be root's: choose another "
                "folder by --folder"
            )
        folder.mkdir(mode=0o700, exist_ok=True)
        os.chown(folder, self.user, self.group, follow_symlinks=False)
        folder.parent.chmod(0o711)
        for needed in (folder, Path(os.__file__).parent, Path(__file__).parent):
            self.check_reads(needed)

    def check_reads(self, folder: Path) -> None:
        """Raise UsageError unless this user can read a folder."""
        try:
            with rights_of(self):
                next(folder.iterdir(), None)
        except PermissionError:
            raise UsageError(
                f"--run-as {self.name}: this user cannot read {folder}: Python, Poise "
                "and the agent's folder (--folder) must be where he can"
            ) from None

    def let_read(self, folder: Path) -> None:
        """Let this user's group read what is in a folder, and write nothing."""
        for path in (folder, *folder.rglob("*")):
            os.chown(path, -1, self.group, follow_symlinks=False)
            mode = path.stat().st_mode
            path.chmod(mode | (mode >> 3 & 0o050))


@contextmanager
def rights_of(account: Account | None) -> Iterator[None]:
    """Let this thread use files as a user may; None: as it is.

    The kernel takes root's rights over files away meanwhile (setfsuid(2)). RunError: it
    does not; nothing is used then.
    """
    if account is None:
        yield
        return
    libc = ctypes.CDLL(None)
    try:
        libc.setfsgid(account.group)
        libc.setfsuid(account.user)
        # neither says that it failed; -1 changes nothing, and tells who it is now
        if (libc.setfsgid(-1), libc.setfsuid(-1)) != (account.group, account.user):
            raise RunError(f"this agent may not use files as '{account.name}' does")
        yield
    finally:
        libc.setfsuid(0)
        libc.setfsgid(0)
