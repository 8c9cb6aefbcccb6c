from __future__ import annotations

import math

import numpy as np
import pytest

from tests.trot.alone import VirtualClock, alone
from trot.arm import geometry
from trot.arm.arm_controller import ArmController
from trot.arm.arm_kinematics import ArmKinematics
from trot.arm.collision_checker import CollisionChecker
from trot.arm.trajectory_planner import TrajectoryPlanner, between
from trot.audition.attention_planner import AttentionPlanner
from trot.audition.sound_localiser import SoundLocaliser
from trot.audition.speech_detector import SpeechDetector
from trot.interaction.dialogue_manager import DialogueManager
from trot.interaction.emotion_model import EmotionModel
from trot.interaction.face_animator import face
from trot.interaction.face_display import compose
from trot.interaction.speech_synthesiser import sound
from trot.interaction.utterance_parser import UtteranceParser
from trot.messages import (
    Activity,
    AudioBlock,
    Bearing,
    Image,
    Sentence,
    Speech,
    Trajectory,
    Utterance,
    Wish,
)
from trot.recommender.programme_guide import ProgrammeGuide
from trot.recommender.rating_model import RatingModel
from trot.recommender.recommendation_presenter import (
    RecommendationPresenter,
    draw,
)
from trot.recommender.viewer_profile import ViewerProfile
from trot.world.sound import BEARING, Sound


def test_hears_where_the_speaker_is() -> None:
    localiser = alone(SoundLocaliser)
    localiser.component.audio(AudioBlock(1.0, Sound().block()))
    (bearing,) = localiser.published["bearing"]
    assert bearing.angle == pytest.approx(BEARING, abs=0.05)


def test_tells_speech_from_silence() -> None:
    """The sound has a second of speech, 20 blocks, and then a second of noise."""
    source, detector = Sound(), alone(SpeechDetector)
    for _ in range(40):
        detector.component.audio(AudioBlock(0.0, source.block()))
    probabilities = [a.probability for a in detector.published["activity"]]
    assert min(probabilities[:20]) > 0.9
    assert max(probabilities[20:]) < 0.2


def test_looks_at_the_speaker() -> None:
    planner = alone(AttentionPlanner)
    planner.component.activity(Activity(0.0, 1.0))
    planner.component.bearing(Bearing(0.0, BEARING, 1.0))
    planner.component.plan()
    (attention,) = planner.published["attention"]
    assert attention.bearing == pytest.approx(BEARING, abs=math.radians(5))
    assert attention.urgency > 0.5


def test_a_stretched_arm_reaches_its_length() -> None:
    """The links are 0.82 m long together."""
    hand = geometry.hand(np.zeros(6, np.float32))
    np.testing.assert_allclose(hand, (0.82, 0.0, 0.0), atol=1e-6)


def test_the_first_joint_turns_the_arm() -> None:
    hand = geometry.hand(np.array([math.pi / 2, 0, 0, 0, 0, 0], np.float32))
    np.testing.assert_allclose(hand, (0.0, 0.82, 0.0), atol=1e-6)


def test_kinematics_brings_the_hand_to_its_target() -> None:
    target = np.array([0.4, 0.2, 0.25], np.float32)
    start = np.array([0, 0.6, 0, -0.6, 0, 0], np.float32)
    angles = alone(ArmKinematics, {"cpu": "5 ms"}).component.solve(target, start)
    np.testing.assert_allclose(geometry.hand(angles), target, atol=0.01)


def test_clearance_is_the_height_over_the_table() -> None:
    """The arm is stretched level, and the table 0.35 m below it."""
    level = np.zeros((1, 6), np.float32)
    clearance = alone(CollisionChecker).component.clearance(level)
    assert clearance == pytest.approx(0.35, abs=0.02)


def test_a_trajectory_goes_from_start_to_end() -> None:
    start, end = np.zeros(6, np.float32), np.ones(6, np.float32)
    angles = between(start, end)
    np.testing.assert_allclose(angles[[0, -1]], [start, end])
    assert (np.diff(angles, axis=0) >= 0).all()


def test_the_arm_follows_what_is_planned() -> None:
    asked = {
        "kinematics": alone(ArmKinematics).component,
        "collisions": alone(CollisionChecker).component,
    }
    planner = alone(TrajectoryPlanner, providers=asked)
    planner.component.plan()
    (trajectory,) = planner.published["trajectory"]
    controller = alone(ArmController)
    controller.component.trajectory(trajectory)
    for _ in range(40):
        controller.component.control()
    reached = controller.published["joints"][-1].angles
    np.testing.assert_allclose(reached, trajectory.angles[-1], atol=1e-3)
    assert isinstance(trajectory, Trajectory)


def test_understands_loud_speech_only() -> None:
    parser = alone(UtteranceParser)
    for level in (1.0, 12.0):
        parser.component.speech(Speech(0.0, np.full((20, 20), level, np.float32)))
        parser.component.understand()
    (utterance,) = parser.published["utterance"]
    assert utterance.confidence == pytest.approx(0.75)


def test_answers_when_it_is_its_turn() -> None:
    clock = VirtualClock()
    manager = alone(DialogueManager, clock=clock)
    manager.component.utterance(Utterance(0.0, "greet", 1.0))
    manager.component.turn()
    assert manager.published["sentence"] == []
    clock.time = 2.0
    manager.component.turn()
    (sentence,) = manager.published["sentence"]
    assert sentence.text.startswith("Good morning")
    assert len(manager.published["wish"]) == 1


def test_speaking_wakes_the_robot_and_then_it_calms_down() -> None:
    model = alone(EmotionModel)
    model.component.sentence(Sentence(0.0, "Hello?"))
    for _ in range(50):
        model.component.feel()
    moods = model.published["emotion"]
    assert moods[0].arousal > 0.3
    assert moods[-1].arousal < 0.05


def test_the_face_opens_its_eyes_when_awake() -> None:
    eye = (40, 60, 90)
    tired = (face(0.0, -1.0) == eye).all(axis=-1).sum()
    awake = (face(0.0, 1.0) == eye).all(axis=-1).sum()
    assert awake > 2 * tired


def test_the_screen_shows_the_panel_in_its_corner() -> None:
    panel = Image(0.0, np.full((120, 160, 3), 7, np.uint8))
    screen = compose(Image(0.0, face(0, 0)), panel)
    assert screen.shape == (240, 320, 3)
    assert (screen[-60:, -80:] == 7).all()
    assert not (screen[:-60] == 7).any()


def test_only_vowels_sound() -> None:
    assert np.abs(sound("a")).max() > 5000
    assert not sound("?").any()


def test_recommends_programmes_of_the_wished_genre() -> None:
    guide = alone(ProgrammeGuide).component
    model = alone(RatingModel).component
    asked = {
        "guide": guide,
        "tastes": alone(ViewerProfile).component,
        "ratings": model,
    }
    presenter = alone(RecommendationPresenter, providers=asked)
    presenter.component.wish(Wish(0.0, 3))
    presenter.component.present()
    (panel,) = presenter.published["panel"]
    numbers = [programme.number for programme in guide.search(3)]
    ratings = dict(zip(numbers, model.predict(numbers), strict=True))
    best = sorted(numbers, key=lambda n: (ratings[n], n), reverse=True)[:4]
    np.testing.assert_array_equal(panel.pixels, draw(best))


def test_the_rating_model_learns() -> None:
    effort = alone(RatingModel, {"cpu": "50 ms", "working_set": "1 MiB"})
    model = effort.component
    table = model._effort.next_block()
    before = model._descend(table.copy())
    model.learn()
    assert model._descend(table) < before
