"""The service of systemd that keeps an agent running."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from poise.errors import RunError, UsageError
from poise.session.folders import write_whole
from poise.user_folders import home_folder

_SYSTEM = Path("/etc/systemd/system")
_BOOTED = Path("/run/systemd/system")
_LIMIT = 60.0
"""An agent is ready, or has ended, within this time [s]."""
_UNIT = """\
# `poise agent install` wrote this, and `poise agent uninstall` removes it.
[Unit]
Description={description}
Documentation=man:systemd.service(5)
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={command}
Restart=on-failure
RestartSec=100ms
# the agent died or is restarted, its containers go on: the next agent adopts them
KillMode=process
RestartKillSignal=SIGUSR1
TimeoutStopSec=20
WatchdogSec=10
Delegate=yes
DelegateSubgroup=agent
LimitNICE=-10
NoNewPrivileges=yes
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
{rights}UMask=0077
StandardOutput=journal
StandardError=journal
SyslogIdentifier=poise-{computer}

[Install]
WantedBy={target}
"""


_RIGHTS = """\
CapabilityBoundingSet=CAP_CHOWN CAP_DAC_OVERRIDE CAP_FOWNER CAP_KILL CAP_SETGID \
CAP_SETUID CAP_SYS_NICE CAP_SYS_PTRACE CAP_SYS_RESOURCE
"""
"""All that root needs to limit containers, and to run them as another user."""


class AgentService:
    """The unit of one computer's agent: the machine's, or this user's."""

    def __init__(
        self, robot: str, computer: str, *, is_users: bool, folder: Path | None = None
    ) -> None:
        self.robot, self.computer, self._is_users = robot, computer, is_users
        self.name = f"poise-{robot}-{computer}.service"
        self._description = f"Poise agent of computer {computer} of robot {robot}"
        self._is_elsewhere = folder is not None
        self.path = (folder or _folder(is_users=is_users)) / self.name

    def text(self, arguments: Sequence[str], run_as: str = "") -> str:
        """Return the unit that runs ``poise agent`` with these arguments."""
        arguments = [*arguments, *(["--run-as", run_as] if run_as else [])]
        words = [sys.executable, "-m", "poise", "agent", self.computer, *arguments]
        return _UNIT.format(
            computer=self.computer,
            description=self._description,
            rights=_RIGHTS if run_as else "",
            command=shlex.join(words).replace("%", "%%").replace("$", "$$"),
            target="default.target" if self._is_users else "multi-user.target",
        )

    def install(self, text: str) -> bool:
        """Write the unit and start it, now and at each boot; False: no systemd runs."""
        try:
            self._raise_if_anothers()
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{self.path}: {error.strerror}") from error
        write_whole(self.path, text)
        return self._tell(
            ["daemon-reload"], ["enable", self.name], ["restart", self.name]
        )

    def uninstall(self) -> bool:
        """Stop it, and remove the unit; False: no systemd runs."""
        if not self.path.exists():
            raise UsageError(f"there is no {self.path}: nothing is installed")
        self._raise_if_anothers()
        self._tell(["disable", "--now", self.name])
        self.path.unlink()
        return self._tell(["daemon-reload"])

    def _raise_if_anothers(self) -> None:
        """Raise UsageError if the unit is of robot ``a``, and this one is ``a-b``."""
        lines = self.path.read_text().splitlines() if self.path.exists() else ()
        if lines and f"Description={self._description}" not in lines:
            raise UsageError(
                f"{self.path} is not of computer '{self.computer}' of robot "
                f"'{self.robot}', but has the same name: choose another robot's name"
            )

    def _tell(self, *commands: Sequence[str]) -> bool:
        if self._is_elsewhere or not _runs(is_users=self._is_users):
            return False
        users = ["--user"] if self._is_users else []
        for words in commands:
            command = ["systemctl", *users, *words]
            try:
                done = subprocess.run(  # noqa: S603, no word comes from elsewhere
                    command, capture_output=True, text=True, timeout=_LIMIT, check=False
                )
            except (OSError, subprocess.TimeoutExpired) as error:
                raise RunError(f"`{shlex.join(command)}`: {error}") from error
            if done.returncode:
                log = shlex.join(["journalctl", *users, "-u", self.name])
                why = f"{done.stderr.strip()}; `{log}` may say why"
                raise RunError(f"`{shlex.join(command)}`: {why}")
        return True


def _runs(*, is_users: bool) -> bool:
    """Return whether systemd runs, the machine's or this user's (`sd_booted(3)`)."""
    if not is_users:
        return _BOOTED.exists()
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return runtime is not None and Path(runtime, "systemd/private").exists()


def _folder(*, is_users: bool) -> Path:
    if not is_users:
        return _SYSTEM
    place = os.environ.get("XDG_CONFIG_HOME") or home_folder() / ".config"
    return Path(place) / "systemd/user"
