from __future__ import annotations

import numpy as np
import pytest

from tests.trot.alone import VirtualClock, alone
from trot.messages import Programme, Watched, Wish
from trot.packets import pack_recommended, pack_watched, unpack_recommended
from trot.recommender import audience
from trot.recommender.audience import SLOT, US, Audience, on_air
from trot.recommender.programme_guide import ProgrammeGuide
from trot.recommender.rating_model import RatingModel
from trot.recommender.recommendation_presenter import RecommendationPresenter
from trot.recommender.viewer_profile import ViewerProfile
from trot.world.television import BEFORE, Television


def share_good(numbers: list[int], audience: Audience, shown: np.ndarray) -> float:
    return float(np.mean([audience.is_good(number, shown) for number in numbers]))


def test_a_fifth_of_what_is_shown_is_good() -> None:
    """Of 60 programmes, the 12 that we like best; ties aside."""
    known, shown = Audience(), on_air(3)
    assert share_good(shown.tolist(), known, shown) == pytest.approx(0.2, abs=0.02)


def test_people_watch_what_they_like() -> None:
    known = Audience()
    pairs = known.watch(4000)
    mean = known.liking[pairs[:, 0], pairs[:, 1]].mean()
    assert mean > 2 * known.liking.mean()


@pytest.mark.slow
def test_the_model_learns_what_we_like_from_what_all_watch() -> None:
    """It knows nothing of genres; by chance a fifth would be good."""
    known, model = Audience(), alone(RatingModel, {"factors": 16}).component
    model.watched(Watched(0.0, known.watch(BEFORE)))
    for _ in range(10):
        model._is_new = True
        model.learn()
    good = []
    for slot in range(30):
        shown = on_air(slot)
        scores = model.predict(shown.tolist())
        best = shown[np.argsort(scores)[-3:]]
        good.append(share_good(best.tolist(), known, shown))
    assert np.mean(good) > 0.6


@pytest.mark.slow
def test_a_new_model_knows_what_the_old_one_did() -> None:
    old, new = alone(RatingModel).component, alone(RatingModel).component
    old.watched(Watched(0.0, Audience().watch(500)))
    new.restore(old.snapshot())
    np.testing.assert_array_equal(new._counts, old._counts)
    assert new._counts.sum() == 500


class Set:
    """Plays a device."""

    def __init__(self, *packets: bytes) -> None:
        self.packets = list(packets)
        self.sent: list[tuple[float, int, list[int]]] = []

    def receive(self) -> list[bytes]:
        found, self.packets = self.packets, []
        return found

    def send(self, packet: bytes) -> bool:
        self.sent.append(unpack_recommended(packet))
        return True


def test_the_profile_counts_what_we_watch_only() -> None:
    """We watch programme 5 twice; somebody else watches 7."""
    profile = alone(ViewerProfile)
    pairs = np.array([(US, 5), (US + 1, 7), (US, 5)], np.int32)
    profile.component._television = Set(pack_watched(pairs))
    profile.component.read()
    np.testing.assert_array_equal(profile.published["watched"][0].pairs, pairs)
    weights = profile.component.weights()
    assert weights.sum() == pytest.approx(1.0)
    assert weights.argmax() == Audience().genres[5].argmax()


def test_the_guide_knows_what_is_on_the_air() -> None:
    clock = VirtualClock()
    clock.time = 3.5 * SLOT
    guide = alone(ProgrammeGuide, clock=clock).component
    found = guide.on_air()
    assert {each.number for each in found} == set(on_air(3).tolist())
    genres = np.frombuffer(found[0].genres)
    np.testing.assert_array_equal(genres, Audience().genres[found[0].number])
    guide.cleanup()


class Answers:
    """Four programmes; the model likes the third, and the tastes agree."""

    def on_air(self) -> list[Programme]:
        genres = np.eye(audience.GENRES)
        return [Programme(n, f"Music {n}", genres[n].tobytes(), 9) for n in range(4)]

    def weights(self) -> audience.Floats:
        return np.asarray(np.eye(audience.GENRES)[2])

    def predict(self, numbers: list[int]) -> list[float]:
        return [[0.5, 0.1, 0.9, 0.7][number] for number in numbers]


def test_recommends_the_best_first_and_says_who_asked() -> None:
    answers = Answers()
    asked = {"guide": answers, "tastes": answers, "ratings": answers}
    presenter = alone(RecommendationPresenter, providers=asked)
    presenter.component._remote_control = television = Set()
    presenter.component.present()
    presenter.component.wish(Wish(4.5))
    assert television.sent == [(0.0, 9, [2, 3, 0]), (4.5, 9, [2, 3, 0])]
    assert presenter.published["shown"] == [True]
    assert presenter.published["panel"][0].pixels.std() > 10


def test_the_television_judges_what_is_recommended() -> None:
    """The best and the worst of what is shown: half is good; asked 0.3 s before."""
    television, known, shown = Television(), Audience(), on_air(7)
    order = shown[np.argsort(known.liking[US][shown])]
    packet = pack_recommended(1.0, 7, [int(order[0]), int(order[-1])])
    television.take(packet, now=5.3, asked=5.0)
    assert television.result() == {
        "recommended": 2,
        "good_recommendations": 0.5,
        "recommendation_seconds": pytest.approx(0.3),
    }
