"""Follow faces from image to image, so that each keeps its id.

A track moves on with constant velocity in the images' own time, and a detection near where it is
expected continues it. Sure detections are matched first, with the faces of the last image before
those that were hidden in it, so that who walks behind another takes nobody's place; then unsure
ones with the known faces that are left. A new face needs one very sure detection and is confirmed
by the next images, so that a flicker in the background never becomes a face.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from vertebra_face_tracking.backend import Detection
from vertebra_face_tracking.geometry import Floats, iou

BIRTH_SCORE: Final = 0.75
"""A new face must be this sure; textures reach 0.7."""
STRONG_SCORE: Final = 0.6
"""What is less sure only continues a known face."""
CONFIRM_HITS: Final = 3
"""Images in a row that must show a new face before it gets an id."""
REACH: Final = 1.0
"""How far from where it was expected a face may be, in face sizes."""
MAX_SIZE_RATIO: Final = 2.0
"""How much larger or smaller than it was a face may be."""
VELOCITY_MEMORY_S: Final = 0.2
"""Velocity is averaged over about this time."""


@dataclass(frozen=True, slots=True)
class TrackedFace:
    """A detection and whose it is; `age_s` is how long this face has been followed."""

    track_id: int
    detection: Detection
    age_s: float


@dataclass(slots=True)
class _Track:
    """A face that is followed; it has an id once it is confirmed."""

    born_ns: int
    seen_ns: int
    box: Floats
    velocity_px_s: Floats
    hits: int = 1
    track_id: int | None = None

    def expected_box(self, now_ns: int) -> Floats:
        box = self.box.copy()
        box[:2] += self.velocity_px_s * _seconds(now_ns - self.seen_ns)
        return box

    def see(self, box: Floats, now_ns: int) -> None:
        elapsed_s = _seconds(now_ns - self.seen_ns)
        if elapsed_s:
            measured = (_centre(box) - _centre(self.box)) / elapsed_s
            weight = max(1 / self.hits, 1 - math.exp(-elapsed_s / VELOCITY_MEMORY_S))
            self.velocity_px_s += weight * (measured - self.velocity_px_s)
        self.box = box
        self.seen_ns = now_ns
        self.hits += 1


class Tracker:
    """Faces of one camera.

    Args:
        ids: Where new ids come from; trackers that share it never use one twice.
        keep_s: How long a face that is hidden keeps its id. If images are further apart than
            this, nothing can be followed: every face is new.
    """

    def __init__(self, ids: Iterator[int], *, keep_s: float) -> None:
        self._keep_s = keep_s
        self._now_ns: int | None = None
        self._tracks: list[_Track] = []
        self._ids = ids

    def update(self, detections: Sequence[Detection], captured_ns: int) -> list[TrackedFace]:
        """Take what was detected in the next image and return the faces in it, oldest id first.

        Args:
            detections: Of one image, boxes hardly overlapping.
            captured_ns: When the image was taken. A step back of up to `keep_s` counts as no time.
        """
        confirm_hits = CONFIRM_HITS
        last_ns = self._now_ns
        if last_ns is None or abs(_seconds(captured_ns - last_ns)) > self._keep_s:
            # No earlier image to compare with: waiting for more would hide what is seen now.
            self._tracks.clear()
            last_ns = captured_ns
            confirm_hits = 1
        self._now_ns = now_ns = max(last_ns, captured_ns)
        known = [t for t in self._tracks if _seconds(now_ns - t.seen_ns) <= self._keep_s]
        current = [track for track in known if track.seen_ns == last_ns]
        hidden = [track for track in known if track.seen_ns != last_ns]
        strong = [d for d in detections if d.score >= STRONG_SCORE]
        weak = [d for d in detections if d.score < STRONG_SCORE]

        seen, unclaimed = _match(current, strong, now_ns)
        returned, strangers = _match(hidden, unclaimed, now_ns)
        seen += returned
        missed = [t for t in known if t.track_id is not None and not _among(t, seen)]
        seen += _match(missed, weak, now_ns)[0]
        missed = [track for track in missed if not _among(track, seen)]
        for stranger in strangers:
            if stranger.score >= BIRTH_SCORE:
                seen.append((_Track(now_ns, now_ns, _row(stranger), np.zeros(2)), stranger))

        self._tracks = [track for track, _ in seen] + missed
        for track, _ in seen:
            if track.track_id is None and track.hits >= confirm_hits:
                track.track_id = next(self._ids)
        faces = [
            TrackedFace(track.track_id, detection, _seconds(now_ns - track.born_ns))
            for track, detection in seen
            if track.track_id is not None
        ]
        return sorted(faces, key=lambda face: face.track_id)


def _match(
    tracks: list[_Track], detections: list[Detection], now_ns: int
) -> tuple[list[tuple[_Track, Detection]], list[Detection]]:
    """Pair tracks with detections, likest first; return the pairs and the detections left over."""
    if not tracks or not detections:
        return [], detections
    expected = np.array([track.expected_box(now_ns) for track in tracks])
    boxes = np.array([_row(detection) for detection in detections])
    likeness = _likeness(expected, boxes)
    pairs: list[tuple[_Track, Detection]] = []
    left = dict(enumerate(detections))
    while likeness.max() > 0:
        row, column = divmod(int(likeness.argmax()), len(detections))
        tracks[row].see(boxes[column], now_ns)
        pairs.append((tracks[row], left.pop(column)))
        likeness[row, :] = likeness[:, column] = 0
    return pairs, list(left.values())


def _likeness(expected: Floats, boxes: Floats) -> Floats:
    """Return 0 to 2 for each pair: overlap plus nearness of the centres in face sizes; 0 is no."""
    sizes_a = np.sqrt(expected[:, 2] * expected[:, 3])[:, None]
    sizes_b = np.sqrt(boxes[:, 2] * boxes[:, 3])[None]
    centres_a = expected[:, :2] + expected[:, 2:] / 2
    centres_b = boxes[:, :2] + boxes[:, 2:] / 2
    distance = np.linalg.norm(centres_a[:, None] - centres_b[None], axis=2)
    nearness = 1 - distance / (REACH * (sizes_a + sizes_b) / 2)
    ratio = np.maximum(sizes_a, sizes_b) / np.minimum(sizes_a, sizes_b)
    fits = (nearness > 0) & (ratio <= MAX_SIZE_RATIO)
    return np.where(fits, iou(expected, boxes) + nearness, 0)


def _among(track: _Track, seen: list[tuple[_Track, Detection]]) -> bool:
    return any(track is other for other, _ in seen)


def _row(detection: Detection) -> Floats:
    box = detection.box
    return np.array([box.x, box.y, box.width, box.height], np.float64)


def _centre(box: Floats) -> Floats:
    return box[:2] + box[2:] / 2


def _seconds(duration_ns: int) -> float:
    return duration_ns / 1e9
