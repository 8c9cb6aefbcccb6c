"""A robot's own authority: who makes certificates, renews them, and replaces itself.

The folder of the person who owns the robot holds his keys and, below ``owner/``, what
signs. `cryptography` does all that is cryptographic.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec import Struct

from poise.errors import UsageError
from poise.session.arguments import check_name
from poise.wire.credentials import (
    AUTHORITY,
    CERTIFICATE,
    HEARTBEATS,
    PRIVATE_KEY,
    Credentials,
    Role,
    folders,
)

DAYS = 90
"""A certificate ends after this time [days]."""
MOST_DAYS = 3650
"""The authority's own ends after this time [days]."""
_EARLIER = timedelta(hours=1)
"""Clocks of computers may be so late."""
_OWNER = "owner"
_Which = Literal["current", "next", "previous"]
_ORDER: tuple[_Which, ...] = "current", "next", "previous"
_ROBOT, _NAME, _ROLE = (
    NameOID.ORGANIZATION_NAME,
    NameOID.ORGANIZATIONAL_UNIT_NAME,
    NameOID.COMMON_NAME,
)


class Authority(Struct, frozen=True):
    """Who signs the certificates of a robot; `folder`: the keys of its owner."""

    robot: str
    folder: Path

    def issue(
        self, name: str, role: Role, folder: Path, *, days: float = DAYS
    ) -> Credentials:
        """Write keys for a computer or a person; those that were there are replaced.

        `days`: how long the certificate holds; not longer than that of the authority.
        UsageError: the authority's own key is not here, or the folder, which becomes
        private to its user, cannot be written.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        usages = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
        certificate = (
            _draft(self.robot, role, name, key.public_key(), min(_in(days), self.ends))
            .issuer_name(self._certificate.subject)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
            .add_extension(x509.ExtendedKeyUsage(usages), False)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName(role)]), False)
            .sign(self._key, hashes.SHA256())
        )
        beside = folder.with_name(f".{folder.name}.{os.getpid()}")
        try:
            beside.mkdir(mode=0o700, parents=True)
            for part, data in {
                AUTHORITY: b"".join(self._known(".pem")),
                CERTIFICATE: _pem(certificate),
                PRIVATE_KEY: _private(key),
            }.items():
                _write(beside / part, data)
            if role != "viewer":  # who could say that computers live, or are lost
                signing = b"\n".join(self._known(".heartbeats"))
                _write(beside / HEARTBEATS, signing)
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            for file in beside.iterdir():
                file.replace(folder / file.name)
            issued = Credentials(folder)
            if role == "viewer":  # as who had another role there may be now
                (folder / HEARTBEATS).unlink(missing_ok=True)
                if issued.to_lead.is_dir():
                    shutil.rmtree(issued.to_lead)
        except OSError as error:
            raise UsageError(
                f"{folder} cannot be written: {error.strerror or error}"
            ) from None
        finally:
            shutil.rmtree(beside, ignore_errors=True)
        return issued

    def rotate(self) -> bool:
        """Take the next step towards another authority; return whether it signs now.

        The first step makes the next authority known, the second lets it sign, the
        third, which is the first towards one more, forgets the old one: issue all keys
        again after each.
        """
        owner = self.folder / _OWNER
        try:
            if not (owner / "next.pem").exists():
                for path in owner.glob("previous.*"):
                    path.unlink()
                _make_authority(self.robot, owner, "next")
                return False
            # the certificate last: a step that was cut short can be taken again
            for suffix in (".heartbeats", ".key", ".pem"):
                if (owner / f"next{suffix}").exists():
                    if suffix != ".key":  # it signs no more
                        before = self._read(f"current{suffix}")
                        _write(owner / f"previous{suffix}", before)
                    (owner / f"next{suffix}").replace(owner / f"current{suffix}")
        except OSError as error:
            raise UsageError(
                f"{owner} cannot be written: {error.strerror or error}"
            ) from None
        return True

    @property
    def ends(self) -> datetime:
        """When its own certificate ends, and with it all keys."""
        return self._certificate.not_valid_after_utc

    @property
    def _certificate(self) -> x509.Certificate:
        try:
            return x509.load_pem_x509_certificate(self._read("current.pem"))
        except ValueError:
            raise self._damaged("current.pem") from None

    @property
    def _key(self) -> ec.EllipticCurvePrivateKey:
        try:
            key = serialization.load_pem_private_key(self._read("current.key"), None)
        except ValueError:
            raise self._damaged("current.key") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise UsageError(f"{self.folder / _OWNER}: current.key is of another kind")
        return key

    def _damaged(self, name: str) -> UsageError:
        return UsageError(
            f"{self.folder / _OWNER / name} is damaged: copy it back, or remove "
            f"{self.folder / _OWNER}, then `poise keys init` makes another authority, "
            "and all need its keys"
        )

    def _known(self, suffix: str) -> Iterator[bytes]:
        for which in _ORDER:
            if (self.folder / _OWNER / f"{which}{suffix}").exists():
                yield self._read(f"{which}{suffix}")

    def _read(self, name: str) -> bytes:
        try:
            return (self.folder / _OWNER / name).read_bytes()
        except OSError as error:
            raise UsageError(
                f"the authority of robot '{self.robot}' is not here "
                f"({self.folder / _OWNER / name}: {error.strerror}): `poise keys init` "
                "makes one, once, on the computer of its owner"
            ) from None


def authority_of(robot: str, folder: Path | None = None) -> Authority:
    """Return the authority of a robot; UsageError: it has none here."""
    authority = Authority(robot, folder or folders(robot)[0])
    subject = authority._certificate.subject  # noqa: SLF001, it is read
    of = [name.value for name in subject.get_attributes_for_oid(_ROBOT)]
    if of != [robot]:
        raise UsageError(
            f"the authority in {authority.folder} is robot '{''.join(map(str, of))}'s, "
            f"not '{robot}'s"
        )
    return authority


def init_keys(robot: str, folder: Path | None = None) -> Authority:
    """Make the authority of a robot, and keys for who owns it, in that folder."""
    check_name(robot, "a robot's name")
    authority = Authority(robot, folder or folders(robot)[0])
    owner = authority.folder / _OWNER
    if (owner / "current.pem").exists():
        raise UsageError(
            f"robot '{robot}' has an authority in {authority.folder}: `poise keys "
            "issue` makes keys, `poise keys rotate` another authority"
        )
    try:
        owner.mkdir(mode=0o700, parents=True, exist_ok=True)
        authority.folder.chmod(0o700)
        _make_authority(robot, owner, "current")
    except OSError as error:
        raise UsageError(
            f"{owner} cannot be written: {error.strerror or error}"
        ) from None
    authority.issue("owner", "manager", authority.folder)
    return authority


def _make_authority(robot: str, owner: Path, which: _Which) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    name = secrets.token_hex(4)  # tells it from the one before
    draft = _draft(robot, "authority", name, key.public_key(), _in(MOST_DAYS))
    certificate = (
        draft.issuer_name(draft._subject_name)  # type: ignore[arg-type]  # noqa: SLF001
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), True)
        .sign(key, hashes.SHA256())
    )
    _write(owner / f"{which}.key", _private(key))
    _write(owner / f"{which}.heartbeats", secrets.token_hex(32).encode())
    _write(owner / f"{which}.pem", _pem(certificate))


def _draft(
    robot: str, role: str, name: str, key: ec.EllipticCurvePublicKey, ends: datetime
) -> x509.CertificateBuilder:
    words = {_ROBOT: robot, _NAME: name, _ROLE: role}
    subject = x509.Name([x509.NameAttribute(*word) for word in words.items()])
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.now(UTC) - _EARLIER)
        .not_valid_after(ends)
    )


def _in(days: float) -> datetime:
    return datetime.now(UTC) + timedelta(days=days)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _write(path: Path, data: bytes) -> None:
    """Write a file that only its user can read, whole or not at all."""
    draft = path.with_name(f".{path.name}.draft")
    draft.unlink(missing_ok=True)
    try:
        draft.touch(0o600, exist_ok=False)
        draft.write_bytes(data)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
