"""Components that crash again and again run elsewhere, or are put aside."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

import poise
from poise.emulate import EmulatedSet, look
from tests.command import robot_up, run_poise
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = """
import os
from poise import Component, every

class Worker(Component):
    @every(0.05)
    def tick(self):
        path = os.path.join(self.parameters["folder"], self.name)
        with open(path + ".log", "a") as file:
            file.write(f"{os.getpid()}\\n")
        at = os.environ["POISE_COMPUTER"] if "POISE_COMPUTER" in os.environ else ""
        if os.path.exists(path + ".crash") and not os.path.exists("/proc/self/never"):
            os._exit(3)
"""
FILE = """
robot: {name}
computers:
  left: {{cpu: 0.5, memory: 512 MiB}}
  right: {{cpu: 0.5, memory: 512 MiB}}
architectures:
  shaky:
    function: shake
    components:
      shaky: {{implementation: "workers_of_test:Worker", cpu: 5%, memory: 30 MiB,
              parameters: {{folder: "{folder}"}}}}
  steady:
    function: stand
    components:
      steady: {{implementation: "workers_of_test:Worker", cpu: 5%, memory: 30 MiB,
               parameters: {{folder: "{folder}"}}}}
tasks:
  work: {{actions: [{{name: work, functions: [shake, stand]}}]}}
"""
