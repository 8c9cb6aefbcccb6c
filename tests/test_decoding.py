"""Decoders that several threads make at once."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.waiting import LONG

RACE = """
import sys
import threading

import msgspec

from poise.decoding import msgpack_decoder

lines = ["import msgspec"]
for k in range(30):
    inner = "int" if k == 0 else f"tuple[S{k - 1}, ...]"
    lines += [f"class S{k}(msgspec.Struct):", f"    inner: {inner}"]
exec("\\n".join(lines))
value = 1
for k in range(30):
    value = globals()[f"S{k}"](value if k == 0 else (value,))
data = msgspec.msgpack.encode(value)
sys.setswitchinterval(1e-6)
ready, wrong = threading.Barrier(8), []


def decode():
    ready.wait()
    if msgpack_decoder(S29).decode(data) != value:
        wrong.append(1)


threads = [threading.Thread(target=decode) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
sys.exit(len(wrong))
"""


@pytest.mark.slow
def test_decoders_that_threads_make_at_once_work() -> None:
    """With msgspec's own, seven of ten such processes crashed."""
    for _ in range(5):
        argv = [sys.executable, "-c", RACE]
        done = subprocess.run(
            argv, timeout=LONG, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
