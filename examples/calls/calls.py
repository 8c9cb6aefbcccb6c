"""Calls to measure: 64 bytes there and back, to a component that does nothing else."""

import time
from typing import Protocol

from poise import CallError, Component, Message, Provided, Required, every


class Parcel(Message):
    content: bytes


class Answers(Protocol):
    def answer(self, parcel: Parcel) -> Parcel: ...


class Echo(Component):
    answers: Provided[Answers]

    def answer(self, parcel: Parcel) -> Parcel:
        return parcel


class Caller(Component):
    near: Required[Answers]
    far: Required[Answers]

    def configure(self) -> None:
        self.parcel = Parcel(bytes(64))

    @every(0.01)
    def call(self) -> None:
        for name, port in (("near", self.near), ("far", self.far)):
            started = time.perf_counter()
            try:
                port.answer(self.parcel)
            except CallError as error:  # when the robot stops, one end is the first
                self.log.debug("%s: %s", name, error)
                continue
            self.measure(name, time.perf_counter() - started)
