from __future__ import annotations

import numpy as np
import pytest

from tests.trot.alone import alone
from trot.interaction.dialogue_manager import DialogueManager
from trot.interaction.face_animator import face
from trot.interaction.household_knowledge import HouseholdKnowledge
from trot.interaction.screen_display import HEIGHT, WIDTH, compose
from trot.interaction.speech_recogniser import SpeechRecogniser
from trot.interaction.speech_synthesiser import SpeechSynthesiser
from trot.interaction.voice_detector import VoiceDetector
from trot.messages import AudioBlock, Image, Sentence, Speech, Utterance
from trot.packets import SAMPLE_RATE, Screen, pack_screen, unpack_screen
from trot.world.person import Asked, Person, word_errors
from trot.world.record import SENTENCES, VOICES, recorded
from trot.world.sound import Sound

ROBOT = (2.5, 3.5, 0.3)
"""Where it hears the person from, through a room with echoes."""


def blocks(samples: np.ndarray) -> list[AudioBlock]:
    """Return what the robot hears: silence, a sentence, silence."""
    source = Sound()
    found = [source.block(ROBOT) for _ in range(8)]
    source.say(samples)
    while source.is_speaking:
        found.append(source.block(ROBOT))
    found += [source.block(ROBOT) for _ in range(12)]
    return [AudioBlock(0.05 * n, block) for n, block in enumerate(found)]


@pytest.mark.slow
def test_cuts_out_one_sentence() -> None:
    """It is as long as what was said, to half a second, and its end is told once."""
    _, samples = recorded()[0]
    detector = alone(VoiceDetector)
    for block in blocks(samples):
        detector.component.audio(block)
    heard = detector.published["speech"]
    assert [part.ends for part in heard].count(True) == 1
    assert {type(part.ends) for part in heard} == {bool}, "else no message takes it"
    assert heard[-1].ends
    length = sum(len(part.samples) for part in heard)
    assert length == pytest.approx(len(samples), abs=0.5 * SAMPLE_RATE)


@pytest.mark.slow
def test_understands_what_people_say_in_a_room_with_echoes() -> None:
    """Of all sentences of both voices, at most 3 of 90 words are wrong."""
    recogniser = alone(SpeechRecogniser, {"captions": False})
    wrong = words = 0
    for sentence, samples in recorded():
        detector = alone(VoiceDetector)
        recogniser.published["utterance"].clear()
        for block in blocks(samples):
            detector.component.audio(block)
        for part in detector.published["speech"]:
            recogniser.component.speech(part)
        heard = " ".join(each.text for each in recogniser.published["utterance"])
        wrong += word_errors(sentence.split(), heard.split())
        words += len(sentence.split())
    assert words == 90
    assert wrong <= 3


@pytest.mark.slow
def test_writes_captions_while_somebody_speaks() -> None:
    (samples,) = [s for text, s in recorded()[:10] if text == "good morning robot"]
    recogniser = alone(SpeechRecogniser)
    for first in range(0, len(samples), 1600):
        part = samples[first : first + 1600]
        recogniser.component.speech(Speech(0.0, part, ends=False))
    assert "good morning" in recogniser.published["caption"][-1].text
    assert recogniser.published["utterance"] == []


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        ("where are my glasses", "The glasses are on the table in the kitchen."),
        ("where is the remote control", "The remote control is under the sofa."),
        ("where is the book", "I have not seen the book."),
        ("when does the doctor come", "The doctor comes at ten."),
        ("how warm is it outside", "It has seven degrees outside."),
        ("good evening robot", "Good evening. How are you?"),
        ("thank you robot", "You are welcome."),
        ("put the cup on the left", "I put the cup on the left."),
    ],
)
def test_answers(said: str, answer: str) -> None:
    knowledge = alone(HouseholdKnowledge).component
    dialogue = alone(DialogueManager, providers={"knowledge": knowledge})
    dialogue.component.utterance(Utterance(0.0, said))
    (sentence,) = dialogue.published["sentence"]
    assert (sentence.text, sentence.heard) == (answer, said)
    knowledge.cleanup()


def test_orders_what_is_asked_for() -> None:
    dialogue = alone(DialogueManager)
    dialogue.component.utterance(Utterance(0.0, "put the cup on the right"))
    dialogue.component.utterance(Utterance(0.0, "what is on television"))
    assert [order.side for order in dialogue.published["order"]] == ["right"]
    assert len(dialogue.published["wish"]) == 1


def test_a_successor_knows_what_was_learnt() -> None:
    old = alone(HouseholdKnowledge).component
    old._learn([("book", "is", "cupboard")])
    new = alone(HouseholdKnowledge).component
    new.restore(old.snapshot())
    assert new.ask("book", "is") == "in the cupboard"
    for each in (old, new):
        each.cleanup()


class Speakers:
    def __init__(self) -> None:
        self.samples = b""

    def send(self, packet: bytes) -> bool:
        self.samples += packet
        return True


def test_speaks_for_as_long_as_a_sentence_takes() -> None:
    """Five words take 1 to 3 s; the mouth opens and closes meanwhile."""
    synthesiser = alone(SpeechSynthesiser)
    synthesiser.component._speakers = speakers = Speakers()
    synthesiser.component.sentence(Sentence(0.0, "I put the cup down.", ""))
    for _ in range(100):
        synthesiser.component.speak()
    assert 1.0 < len(speakers.samples) / 2 / SAMPLE_RATE < 3.0
    loud = [mouth.loudness for mouth in synthesiser.published["mouth"]]
    assert max(loud) > 0.3
    assert min(loud) < 0.1


def test_a_speaking_mouth_is_open_and_eyes_follow() -> None:
    """A mouth is 12 to 54 rows high in the middle; looks move the eyes."""
    red = (60, 60, 170)
    silent, speaks = face(0.0, 0.0, closed=False), face(0.0, 1.0, closed=False)
    heights = [(each[:, 160] == red).all(axis=1).sum() for each in (silent, speaks)]
    assert heights[0] == pytest.approx(10, abs=3)
    assert heights[1] == pytest.approx(54, abs=4)
    eyes = [face(gaze, 0.0, closed=False)[95, :160] for gaze in (-1.0, 1.0)]
    right, left = (np.nonzero((e == (90, 60, 40)).all(axis=1))[0].mean() for e in eyes)
    assert left - right == pytest.approx(24, abs=4)


def test_the_screen_shows_face_panel_and_text() -> None:
    image = Image(0.0, face(0.0, 0.0, closed=True))
    panel = Image(0.0, np.full((150, 240, 3), 7, np.uint8))
    pixels = compose(image, panel, ("good morning", "Good morning."))
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    assert (pixels[:150, -240:] == 7).all()
    assert pixels[HEIGHT - 90 :].std() > compose(image, None, ())[HEIGHT - 90 :].std()


def test_a_screen_packet_says_what_was_understood() -> None:
    screen = Screen(1.5, "what is the time", "It is ten.", "Anna", b"picture")
    assert unpack_screen(pack_screen(screen)) == screen


def test_counts_wrong_words() -> None:
    """One changed, one missing, one too many."""
    assert word_errors(["put", "the", "cup", "on"], ["put", "a", "cup"]) == 2
    assert word_errors([], ["oh"]) == 1


def test_says_every_sentence_and_then_waits() -> None:
    person = Person(seed=3)
    assert person.speak(90.0, listens=False) is None
    assert person.speak(100.0, listens=True) is None
    assert person.speak(101.0, listens=True) is not None
    assert person.speak(101.5, listens=True) is None
    assert len(recorded()) == len(SENTENCES) * len(VOICES)


def test_counts_an_answer_that_fits() -> None:
    asked = Asked("put the cup on the left", ends=5.0)
    fits = [asked.is_answered]
    for answer in ("I put the cup on the left.", "I put the cup on the right."):
        asked.answered, asked.answer = 0.4, answer
        fits.append(asked.is_answered)
    assert fits == [False, True, False]


def test_judges_answers_by_screen_and_voice() -> None:
    """The voice begins 0.5 s after the sentence; what was said before is not meant."""
    person = Person()
    person.speak(0.0, listens=True)
    person.speak(1.0, listens=True)
    ends = person.asked[0].ends
    person.read(Screen(ends - 0.1, "old", "Old.", "", b""))
    person.hear(ends + 0.5)
    person.read(Screen(ends + 0.4, person.asked[0].sentence, "Well.", "", b""))
    result = person.result(ends + 10)
    assert result["word_error_rate"] == 0
    assert result["answer_seconds"] == 0.5
    assert result["sentences"] == 1
    said = person.asked[0].sentence
    assert result["conversation"] == [{"said": said, "heard": said, "answer": "Well."}]
