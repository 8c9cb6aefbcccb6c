"""Decides what to say, and what else an utterance asks for."""

from __future__ import annotations

from poise import Component, Message, Published, every, subscribed
from trot.effort import Block, Effort
from trot.messages import Sentence, Utterance, Wish

ANSWERS = {
    "greet": "Good morning. How are you today?",
    "bring": "I am on my way to the kitchen.",
    "television": "This is what you may like to see.",
    "stop": "I stop.",
    "chat": "Tell me more about it.",
}
TURN = 2.0
"""[s] The robot does not speak more often than this."""


class Turns(Message, frozen=True):
    """How many turns the dialogue has had."""

    count: int


class DialogueManager(Component):
    """Answers the newest utterance when it is the robot's turn."""

    sentence: Published[Sentence]
    wish: Published[Wish]

    def configure(self) -> None:
        self._effort = Effort.declared(self.parameters)
        self._heard: Utterance | None = None
        self._spoke = self.clock.now()
        self._turns = 0

    @subscribed(keep=2)
    def utterance(self, message: Utterance) -> None:
        self._heard = message

    @every(0.1)
    def turn(self) -> None:
        self._effort.spend(_policy, self._effort.start())
        now = self.clock.now()
        if self._heard is None or now - self._spoke < TURN:
            return
        heard, self._heard = self._heard, None
        self._spoke = now
        self._turns += 1
        self.sentence.publish(Sentence(now, ANSWERS[heard.intent]))
        self.wish.publish(Wish(now, self._turns % 16))

    def snapshot(self) -> Turns:
        return Turns(self._turns)

    def restore(self, state: Turns) -> None:
        self._turns = state.count


def _policy(block: Block) -> float:
    """Return the value of the best of 128 states of a dialogue, one sweep on."""
    gain = block.reshape(128, 128)
    return float((gain + 0.9 * gain.max(axis=1)).max(axis=1).max())
