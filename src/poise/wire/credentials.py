"""Who takes part in a robot: certificates of the robot's own authority, in one folder.

With them managers, agents and containers speak TLS 1.3 with each other, and heartbeats
carry a keyed MAC. What a peer may do follows from its role, the common name in its
certificate, for zenoh's access control knows that only.
"""

from __future__ import annotations

import contextlib
import hmac
import os
import ssl
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cached_property
from hashlib import blake2s
from pathlib import Path
from typing import Any, Literal, cast

from poise.clock import wall_time
from poise.errors import PoiseError, RunError, UsageError
from poise.user_folders import home_folder
from poise.wire.address import KEYS

Role = Literal["agent", "manager", "viewer"]
"""What a certificate is for: a computer, who commands the robot, or who only looks."""
AUTHORITY, CERTIFICATE, PRIVATE_KEY = "authority.pem", "certificate.pem", "key.pem"
HEARTBEATS = "heartbeats.key"
FILES = AUTHORITY, CERTIFICATE, PRIVATE_KEY
"""Of each participant; `HEARTBEATS`, of those who send some."""
_DAY = 86400.0
WARN_BEFORE = 14 * _DAY
"""The end of a certificate is warned of this time before [s]."""
TAG_SIZE = 16
_PRIVATE = 0o077


def minute(moment: float) -> str:
    """Return a moment [s since 1970] for people, to the minute."""
    return f"{datetime.fromtimestamp(moment, UTC):%Y-%m-%d %H:%M} UTC"


class Credentials:
    """The keys of one participant, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._renewed: tuple[tuple[int, int], Sequence[bytes]] = (0, 0), ()
        self._raise_if_missing(*FILES)
        for name in FILES:
            try:
                (folder / name).open("rb").close()
            except PermissionError:
                raise UsageError(
                    f"{folder / name} cannot be read by this user: chown it"
                ) from None
        if (folder / PRIVATE_KEY).stat().st_mode & _PRIVATE:
            raise UsageError(
                f"{folder / PRIVATE_KEY} can be read by others: chmod 600 it"
            )

    @cached_property
    def signing(self) -> Sequence[bytes]:
        """The keys of heartbeats, which no viewer has; RunError: they are damaged."""
        return [] if self.role == "viewer" else _hex_keys(self.folder / HEARTBEATS)

    @cached_property
    def subject(self) -> Mapping[str, str]:
        """The words of the certificate's subject: of whom it is, and which robot's."""
        return _subject(self._decoded)

    @property
    def name(self) -> str:
        """Role and name, as in ``agent left``."""
        return f"{self.role} {self.subject.get('organizationalUnitName', '')}"

    @property
    def role(self) -> str:
        """The role."""
        return self.subject.get("commonName", "")

    @property
    def to_lead(self) -> Path:
        """The folder of a computer's keys to lead its robot with, if it may."""
        return self.folder / "leads"

    def leading(self) -> Credentials:
        """Return the keys in `to_lead`; UsageError or RunError: they are no good."""
        leading = Credentials(self.to_lead).check(self.robot, "manager")
        if not (self._trusts(leading) and leading._trusts(self)):  # noqa: SLF001
            raise UsageError(
                f"the keys in {self.to_lead} and {self.folder} are of two authorities: "
                "`poise keys issue --leads` makes both again"
            )
        return leading

    def _trusts(self, other: Credentials) -> bool:
        """Return whether it knows the authority that signed another one's keys."""
        known = (other.folder / AUTHORITY).read_bytes()
        signer = known.partition(ssl.PEM_FOOTER.encode())[0]
        return signer in (self.folder / AUTHORITY).read_bytes()

    @property
    def robot(self) -> str:
        """The robot whose authority signed it."""
        return self.subject.get("organizationName", "")

    @property
    def expires(self) -> float:
        """When the certificate ends [s, since the epoch]."""
        return ssl.cert_time_to_seconds(self._decoded["notAfter"])

    @property
    def begins(self) -> float:
        """From when on the certificate holds [s, since the epoch]."""
        return ssl.cert_time_to_seconds(self._decoded["notBefore"])

    def warning(self) -> str:
        """Return what is wrong with the certificate, or soon is; empty: nothing."""
        now = wall_time()
        if now < self.begins:  # as on a board without a clock that goes on
            return (
                f"the certificate of {self.name} holds from {minute(self.begins)} on, "
                f"and it is {minute(now)} by this computer's clock: set the clock"
            )
        left = self.expires - now
        if left > WARN_BEFORE:
            return ""
        ends = f"ends in {left / _DAY:.1f} days"
        if left < _DAY:
            ends = f"ends at {minute(self.expires)}" if left > 0 else "has ended"
        return f"the certificate of {self.name} {ends}: `poise keys issue` renews it"

    def check(self, robot: str, *roles: Role) -> Credentials:
        """Return these keys; UsageError unless they are this robot's, for a role.

        RunError: they are damaged.
        """
        if self.robot != robot:
            raise UsageError(
                f"the keys in {self.folder} are robot '{self.robot}'s, not '{robot}'s"
            )
        if self.role not in roles:
            raise UsageError(
                f"the keys in {self.folder} are of {self.name}: they must be of "
                f"{' or '.join(roles)}"
            )
        if self.role != "viewer":
            self._raise_if_missing(HEARTBEATS)
            _ = self.signing
        # the clock of an agent's computer may be set in a moment
        is_early = "agent" not in roles and wall_time() < self.begins
        if is_early or self.expires <= wall_time():
            raise UsageError(self.warning())
        self.load()  # zenoh says less of files that are damaged
        return self

    def _raise_if_missing(self, *names: str) -> None:
        missing = [name for name in names if not (self.folder / name).is_file()]
        if missing:
            raise UsageError(
                f"{self.folder} lacks {', '.join(missing)}: `poise keys issue` makes "
                "them"
            )

    @cached_property
    def server(self) -> ssl.SSLContext:
        """For the end that accepts a connection."""
        context = self._context(ssl.PROTOCOL_TLS_SERVER)
        # tickets would come behind the handshake, and look like an answer
        context.num_tickets = 0
        return context

    @cached_property
    def client(self) -> ssl.SSLContext:
        """For the end that connects."""
        return self._context(ssl.PROTOCOL_TLS_CLIENT)

    def load(self) -> None:
        """Read now what connections between containers need: no file is read later."""
        _ = self.server, self.client

    def zenoh(self) -> Iterator[tuple[str, Any]]:
        """Yield the settings of a zenoh session."""
        path = {name: str(self.folder / name) for name in FILES}
        for key, value in {
            "root_ca_certificate": path[AUTHORITY],
            "listen_certificate": path[CERTIFICATE],
            "listen_private_key": path[PRIVATE_KEY],
            "connect_certificate": path[CERTIFICATE],
            "connect_private_key": path[PRIVATE_KEY],
            "enable_mtls": True,
            # addresses change: the authority and the role count
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        }.items():
            yield f"transport/link/tls/{key}", value

    def sign(self, data: bytes) -> bytes:
        """Return data with the MAC of the robot's heartbeats before it."""
        return _mac(data, self.signing[0]) + data

    def verified(self, signed: bytes) -> bytes | None:
        """Return what `sign` was given; None when another key signed it."""
        # a manager goes on while its robot's keys are rotated, and then signs with
        # those that the others sign with
        if not _is_signed(signed, self.signing[:1]):
            renewed = self._renewed_signing()
            if _is_signed(signed, renewed):
                self.signing = renewed
            elif not _is_signed(signed, self.signing):
                return None
        return signed[TAG_SIZE:]

    def _renewed_signing(self) -> Sequence[bytes]:
        """Return the keys of heartbeats that are in the file now."""
        path = self.folder / HEARTBEATS
        try:
            file = _identity(path)
            if file != self._renewed[0]:
                self._renewed = file, _hex_keys(path)
        except (RunError, OSError):  # they are just being written, say
            return []
        return self._renewed[1]

    @cached_property
    def _decoded(self) -> dict[str, Any]:
        path = self.folder / CERTIFICATE
        try:
            return ssl._ssl._test_decode_cert(str(path))  # type: ignore[attr-defined,no-any-return]  # noqa: SLF001
        except (ssl.SSLError, OSError) as error:
            raise RunError(f"{path} is no certificate: {error}") from None

    def _context(self, protocol: int) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.check_hostname = False
        context.verify_mode = ssl.CERT_REQUIRED
        try:
            context.load_verify_locations(self.folder / AUTHORITY)
            context.load_cert_chain(
                self.folder / CERTIFICATE, self.folder / PRIVATE_KEY
            )
        except (ssl.SSLError, OSError) as error:
            raise RunError(f"the keys in {self.folder} are unusable: {error}") from None
        return context


def role_of(peer: Mapping[str, Any] | None) -> str:
    """Return the role in a peer's certificate, as `SSLSocket.getpeercert` gives it."""
    return _subject(peer or {}).get("commonName", "")


def _is_signed(signed: bytes, keys: Sequence[bytes]) -> bool:
    tag, data = signed[:TAG_SIZE], signed[TAG_SIZE:]
    return any(hmac.compare_digest(tag, _mac(data, key)) for key in keys)


def _mac(data: bytes, key: bytes) -> bytes:
    return blake2s(data, digest_size=TAG_SIZE, key=key).digest()


def _hex_keys(path: Path) -> list[bytes]:
    """Return the keys in a file, the one that signs first."""
    try:
        keys = [bytes.fromhex(line) for line in path.read_text().split()]
    except ValueError as error:
        raise RunError(f"{path} is damaged: {error}") from None
    if not keys:
        raise RunError(f"{path} is empty")
    return keys


def _subject(decoded: Mapping[str, Any]) -> dict[str, str]:
    return {key: value for part in decoded.get("subject", ()) for key, value in part}


class RenewableKeys:
    """The keys of a process that may outlive them: those in its folder are renewed.

    It goes on with those that it has where new ones are damaged, not yet there as a
    whole, not its robot's, or not for it to read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = [_identity(folder / name) for name in FILES]
        self._keys = Credentials(folder)
        self._keys.load()
        self._robot, self._role = self._keys.robot, self._keys.role

    def latest(self) -> Credentials:
        """Return the keys; any thread may ask."""
        with contextlib.suppress(PoiseError, OSError):
            files = [_identity(self._folder / name) for name in FILES]
            if files != self._files:
                renewed = Credentials(self._folder)
                renewed.check(self._robot, cast("Role", self._role))
                renewed.load()
                self._files, self._keys = files, renewed
        return self._keys

    @property
    def trouble(self) -> str:
        """Why nobody accepts the certificate now; empty: it holds."""
        keys = self.latest()
        return "" if keys.begins <= wall_time() < keys.expires else keys.warning()


def _identity(path: Path) -> tuple[int, int]:
    """Return what changes when another file takes a file's place."""
    file = path.stat()
    return file.st_ino, file.st_mtime_ns


def folders(robot: str) -> list[Path]:
    """Return where the keys of a robot are looked for, in order."""
    data = os.environ.get("XDG_DATA_HOME") or home_folder() / ".local" / "share"
    return [Path(data) / "poise" / "keys" / robot, Path("/etc/poise/keys") / robot]


def find(robot: str, *roles: Role, folder: Path | None = None) -> Credentials | None:
    """Return a robot's keys for one of these roles; None: there are none here.

    They are in a folder that is given, else that of `KEYS`, else in a usual one.
    UsageError: those that were given are of another robot or role.
    """
    given = folder or (Path(where) if (where := os.environ.get(KEYS)) else None)
    if given is not None:
        return Credentials(given).check(robot, *roles)
    for usual in folders(robot):
        if (usual / CERTIFICATE).exists():
            keys = Credentials(usual)
            if keys.role in roles:
                return keys.check(robot, *roles)
    return None


def raise_if_of_other_role(robot: str, *roles: Role) -> None:
    """UsageError: the keys in a usual folder are of other roles than these."""
    for usual in folders(robot):
        if (usual / CERTIFICATE).exists():
            keys = Credentials(usual)
            leads = "manager" in roles and keys.to_lead.exists()
            try:
                keys.check(robot, *roles)
            except UsageError as error:
                also = f"; POISE_KEYS={keys.to_lead} gives those" if leads else ""
                raise UsageError(f"{error}{also}") from None
