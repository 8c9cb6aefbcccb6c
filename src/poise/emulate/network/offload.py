"""Switches off segmentation offload, which a virtual link would abuse.

With it, a "packet" of 64 KB crosses a virtual link as one, and traffic comes in bursts.
This is the system call behind `ethtool`, which may not be installed.
"""

from __future__ import annotations

import array
import ctypes
import fcntl
import os
import socket
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

_SIOCETHTOOL = 0x8946
_SWITCHES = {"tso": 0x1F, "gso": 0x24, "gro": 0x2C}  # ETHTOOL_STSO, _SGSO, _SGRO
_NEW_NETWORK = 0x40000000  # CLONE_NEWNET


def offload_off(namespace: Path, interfaces: Sequence[str]) -> None:
    """Switch tso, gso and gro off for `interfaces` in `namespace`.

    Raises
    ------
    OSError
        When the namespace cannot be entered or the kernel refuses.
    """
    # Only a thread enters the namespace, and it ends at once.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(_off, namespace, interfaces).result()


def _off(namespace: Path, interfaces: Sequence[str]) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    with namespace.open("rb") as file:
        if libc.setns(file.fileno(), _NEW_NETWORK):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(namespace))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as handle:
        for interface in interfaces:
            for command in _SWITCHES.values():
                _switch_off(handle, interface, command)


def _switch_off(handle: socket.socket, interface: str, command: int) -> None:
    # struct ethtool_value {command, value = 0} and struct ifreq {name, pointer to it}
    value = array.array("I", [command, 0])
    address, _ = value.buffer_info()
    request = struct.pack("16sP16x", interface.encode(), address)
    fcntl.ioctl(handle, _SIOCETHTOOL, request)
