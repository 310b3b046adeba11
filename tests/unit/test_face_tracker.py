"""The tracker keeps ids stable, never uses one twice, and needs no luck with time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vertebra.messages import Box
from vertebra_face_tracking.backend import Detection
from vertebra_face_tracking.tracker import CONFIRM_HITS, TrackedFace, Tracker

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000


def face(x: float, y: float, *, size: float = 40, score: float = 0.9) -> Detection:
    """Return a detection whose centre is at `x`, `y`."""
    box = Box(x=x - size / 2, y=y - size / 2, width=size, height=size)
    return Detection(box=box, score=score)


def new_tracker(*, keep_s: float = 1) -> Tracker:
    return Tracker(count(1), keep_s=keep_s)


def ids(faces: list[TrackedFace]) -> list[int]:
    return [face.track_id for face in faces]


def test_the_first_image_shows_its_faces_at_once() -> None:
    tracker = new_tracker()

    found = tracker.update([face(50, 50), face(200, 50)], START_NS)

    assert ids(found) == [1, 2]
    assert [face.age_s for face in found] == [0, 0]


def test_a_newcomer_is_confirmed_by_images_in_a_row() -> None:
    tracker = new_tracker()
    tracker.update([], START_NS)

    shown = [tracker.update([face(50, 50)], START_NS + i * 50 * MS) for i in range(1, 5)]

    assert [len(faces) for faces in shown] == [0] * (CONFIRM_HITS - 1) + [1, 1]
    assert shown[-1][0].age_s == 0.15


def test_a_flicker_never_becomes_a_face() -> None:
    tracker = new_tracker()
    tracker.update([], START_NS)

    for i in range(1, 40):
        detections = [] if i % CONFIRM_HITS == 0 else [face(50, 50)]
        assert tracker.update(detections, START_NS + i * 33 * MS) == []


def test_an_unsure_detection_is_no_birth_but_continues_a_known_face() -> None:
    tracker = new_tracker()
    assert tracker.update([face(50, 50, score=0.55)], START_NS) == []
    assert tracker.update([face(50, 50, score=0.7)], START_NS + 30 * MS) == []

    tracker = new_tracker()
    tracker.update([face(50, 50)], START_NS)
    weak = face(52, 50, score=0.5)
    (continued,) = tracker.update([weak], START_NS + 30 * MS)
    assert continued.track_id == 1
    assert continued.detection is weak


def test_a_sure_detection_is_preferred_to_an_unsure_one() -> None:
    tracker = new_tracker()
    tracker.update([face(50, 50)], START_NS)
    sure = face(58, 50)

    (found,) = tracker.update([face(50, 50, score=0.5), sure], START_NS + 30 * MS)

    assert found.detection is sure


def test_a_hidden_face_keeps_its_id_for_a_second_and_not_longer() -> None:
    for hidden_ms, expected in ((900, [1]), (1_100, [])):
        tracker = new_tracker()
        tracker.update([face(50, 50)], START_NS)
        for at_ms in range(100, hidden_ms, 100):
            assert tracker.update([], START_NS + at_ms * MS) == []
        assert ids(tracker.update([face(50, 50)], START_NS + hidden_ms * MS)) == expected


def test_a_stream_slower_than_the_memory_shows_every_face_as_new() -> None:
    tracker = new_tracker(keep_s=1)

    found = [ids(tracker.update([face(50, 50)], START_NS + i * 1500 * MS)) for i in range(3)]

    assert found == [[1], [2], [3]]


def test_a_longer_memory_follows_a_slow_stream() -> None:
    tracker = new_tracker(keep_s=4)

    found = [ids(tracker.update([face(50, 50)], START_NS + i * 1500 * MS)) for i in range(3)]

    assert found == [[1], [1], [1]]


def test_the_same_image_twice_and_a_small_step_back_change_nothing() -> None:
    tracker = new_tracker()
    tracker.update([face(50, 50)], START_NS)
    tracker.update([face(60, 50)], START_NS + 50 * MS)

    assert ids(tracker.update([face(60, 50)], START_NS + 50 * MS)) == [1]
    assert ids(tracker.update([face(60, 50)], START_NS + 20 * MS)) == [1]
    assert ids(tracker.update([face(70, 50)], START_NS + 100 * MS)) == [1]


def test_a_clock_that_was_set_back_starts_anew_with_new_ids() -> None:
    tracker = new_tracker()
    tracker.update([face(50, 50)], START_NS)

    assert ids(tracker.update([face(50, 50)], START_NS - 3600 * 1000 * MS)) == [2]


def test_a_box_of_quite_another_size_is_another_face() -> None:
    tracker = new_tracker()
    tracker.update([face(100, 100, size=40)], START_NS)

    assert tracker.update([face(100, 100, size=120)], START_NS + 50 * MS) == []


def test_cameras_that_share_their_ids_use_none_twice() -> None:
    shared = count(1)
    left, right = Tracker(shared, keep_s=1), Tracker(shared, keep_s=1)

    assert ids(left.update([face(50, 50)], START_NS)) == [1]
    assert ids(right.update([face(50, 50)], START_NS)) == [2]
    assert ids(left.update([face(50, 50)], START_NS + 50 * MS)) == [1]


@dataclass
class Person:
    """A person who walks on a straight line."""

    x: float
    y: float
    speed_x: float
    size: float = 40

    def at(self, seconds: float) -> tuple[float, float]:
        return self.x + self.speed_x * seconds, self.y


def watch(
    people: list[Person],
    *,
    seconds: float,
    rate_hz: float,
    hidden: dict[int, tuple[float, float]] | None = None,
    jitter_px: float = 0,
    lost_share: float = 0,
    seed: int = 0,
) -> Iterator[dict[int, int]]:
    """Track a scene and yield, per image, the id of each person that was recognised.

    `hidden` gives per person from when to when nobody sees them; of the images, `lost_share`
    never arrive; boxes are off by `jitter_px`, which is a standard deviation.
    """
    random = np.random.default_rng(seed)
    tracker = new_tracker()
    for number in range(round(seconds * rate_hz)):
        now_s = number / rate_hz + random.uniform(0, 0.3 / rate_hz)
        if random.random() < lost_share:
            continue
        owners: dict[int, int] = {}
        detections = []
        for index in random.permutation(len(people)).tolist():
            person = people[index]
            start_s, end_s = (hidden or {}).get(index, (0, 0))
            if start_s <= now_s < end_s:
                continue
            x, y = np.array(person.at(now_s)) + random.normal(0, jitter_px, 2)
            size = person.size + random.normal(0, jitter_px)
            detection = face(x, y, size=size, score=random.uniform(0.8, 1))
            owners[id(detection)] = index
            detections.append(detection)
        tracked = tracker.update(detections, START_NS + int(now_s * 1e9))
        yield {owners[id(found.detection)]: found.track_id for found in tracked}


def assert_one_id_each(images: list[dict[int, int]], people: int) -> None:
    for person in range(people):
        seen = [image[person] for image in images if person in image]
        assert len(seen) > 10
        assert len(set(seen)) == 1, f"person {person} was called {sorted(set(seen))}"


def test_two_people_who_cross_far_apart_keep_their_ids() -> None:
    people = [Person(20, 60, 90), Person(300, 180, -90)]
    for seed in range(20):
        images = list(
            watch(people, seconds=3, rate_hz=20, jitter_px=1.5, lost_share=0.2, seed=seed)
        )
        assert_one_id_each(images, 2)


def test_a_person_who_walks_behind_a_pillar_keeps_the_id() -> None:
    people = [Person(20, 100, 80), Person(250, 60, 0)]
    for seed in range(20):
        images = list(
            watch(people, seconds=3, rate_hz=20, jitter_px=1, hidden={0: (1.2, 1.9)}, seed=seed)
        )
        assert_one_id_each(images, 2)


def test_a_person_who_passes_behind_another_keeps_the_id() -> None:
    # Centres meet at 1.5 s; the rear one is unseen while they overlap by more than a third.
    people = [Person(40, 100, 80), Person(280, 105, -80)]
    for seed in range(20):
        images = list(
            watch(people, seconds=3, rate_hz=20, jitter_px=1, hidden={1: (1.35, 1.65)}, seed=seed)
        )
        assert_one_id_each(images, 2)


def test_a_slow_camera_keeps_the_ids_of_people_who_sit() -> None:
    people = [Person(50, 100, 4), Person(150, 100, -3), Person(250, 110, 2)]
    for seed in range(20):
        images = list(watch(people, seconds=12, rate_hz=2, jitter_px=2, seed=seed))
        assert_one_id_each(images, 3)


DETECTIONS = st.builds(
    face,
    st.floats(0, 320),
    st.floats(0, 240),
    size=st.floats(5, 120),
    score=st.floats(0.5, 1),
)
IMAGES = st.lists(
    st.tuples(st.lists(DETECTIONS, max_size=5), st.integers(-300, 1500)), min_size=1, max_size=25
)


@given(IMAGES)
def test_whatever_comes_ids_are_unique_and_never_come_back(
    images: list[tuple[list[Detection], int]],
) -> None:
    tracker = new_tracker()
    now_ns = START_NS
    latest_ns = START_NS
    last_seen_ns: dict[int, int] = {}
    for detections, step_ms in images:
        now_ns += step_ms * MS
        latest_ns = max(latest_ns, now_ns)
        found = tracker.update(detections, now_ns)

        assert len(set(ids(found))) == len(found)
        assert len({id(one.detection) for one in found}) == len(found)
        assert all(any(one.detection is d for d in detections) for one in found)
        for track_id in ids(found):
            newest = max(last_seen_ns, default=0)
            assert track_id in last_seen_ns or track_id > newest
            assert latest_ns - last_seen_ns.get(track_id, latest_ns) <= 1_000 * MS
            last_seen_ns[track_id] = latest_ns


@given(IMAGES, st.integers(-(10**18), 10**18))
def test_only_differences_of_time_matter(
    images: list[tuple[list[Detection], int]], shift_ns: int
) -> None:
    one, other = new_tracker(), new_tracker()
    now_ns = START_NS
    for detections, step_ms in images:
        now_ns += step_ms * MS

        assert one.update(detections, now_ns) == other.update(detections, now_ns + shift_ns)
