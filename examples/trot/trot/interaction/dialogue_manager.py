"""Decides what to say and to do when somebody said something."""

from __future__ import annotations

import re
from collections.abc import Callable

from poise import CallError, Component, Message, Published, Required, subscribed
from trot.interfaces import Knowledge
from trot.messages import Order, Sentence, Utterance, Wish

ANNOUNCED = {
    "offer": "I follow you.",
    "announce": "I bring you a cup from the kitchen.",
}
"""What the robot says when an action of a task begins."""


class Turns(Message, frozen=True):
    """How many turns the dialogue has had."""

    count: int


class DialogueManager(Component):
    """Answers each utterance, and orders what it asks for."""

    knowledge: Required[Knowledge]
    sentence: Published[Sentence]
    order: Published[Order]
    wish: Published[Wish]
    said: Published[bool]

    def configure(self) -> None:
        self._turns = 0
        self._rules: list[tuple[str, Callable[..., str]]] = [
            (r"put the cup on the (left|right)", self._put),
            (r"where (is|are) (?:my|the) (.+)", self._where),
            (r"what is on television", self._television),
            (r"what is the time", lambda: f"It is {self._ask('clock', 'shows')}."),
            (r"how warm is it (\w+)", self._warm),
            (r"when does the (\w+) come", self._visit),
            (r"good (morning|evening)", lambda when: f"Good {when}. How are you?"),
            (r"thank you", lambda: "You are welcome."),
        ]

    def begin(self, action: str) -> None:
        """Say what the robot is going to do."""
        text = ANNOUNCED.get(action, "")
        if text:
            self.sentence.publish(Sentence(self.clock.now(), text, ""))
        self.said.publish(bool(text))

    @subscribed(keep=2)
    def utterance(self, message: Utterance) -> None:
        try:
            answer = self._answer(message.text)
        except CallError as error:
            self.log.debug("no knowledge: %s", error)
            answer = "I have to think about it."
        self._turns += 1
        self.sentence.publish(Sentence(self.clock.now(), answer, message.text))

    def snapshot(self) -> Turns:
        return Turns(self._turns)

    def restore(self, state: Turns) -> None:
        self._turns = state.count

    def _answer(self, text: str) -> str:
        for pattern, answer in self._rules:
            if found := re.match(pattern, text):
                return answer(*found.groups())
        return "Please say that again."

    def _put(self, side: str) -> str:
        self.order.publish(Order(self.clock.now(), side))
        return f"I put the cup on the {side}."

    def _television(self) -> str:
        self.wish.publish(Wish(self.clock.now()))
        return "This is what you may like to see."

    def _where(self, verb: str, thing: str) -> str:
        place = self._ask(thing, "is")
        return (
            f"The {thing} {verb} {place}." if place else f"I have not seen the {thing}."
        )

    def _warm(self, where: str) -> str:
        return f"It has {self._ask(where, 'has')} degrees {where}."

    def _visit(self, who: str) -> str:
        when = self._ask(who, "comes")
        return f"The {who} comes {when}." if when else f"The {who} does not come."

    def _ask(self, subject: str, verb: str) -> str:
        return self.knowledge.ask(subject, verb)
