"""Faces, expressions and head poses in the shape of ROS4HRI (REP 155); no I/O.

A face is a namespace of topics, `/humans/faces/<id>/`, which is there as long as the face is; who
is there is told in `/humans/faces/tracked`. Names, units and directions are those of `hri_msgs`,
of `hri_face_detect`, which publishes them on ROS robots, and of `libhri`, which reads them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Final

from vertebra.messages import Expression, Face, Faces, HeadPose, Quaternion, Vector3
from vertebra.ros2.mapping import Record

FACES: Final = "/humans/faces"
TRACKED: Final = f"{FACES}/tracked"
TRACKED_TYPE: Final = "hri_msgs/msg/IdsList"
PARTS: Final = {
    "roi": "hri_msgs/msg/NormalizedRegionOfInterest2D",
    "landmarks": "hri_msgs/msg/FacialLandmarks",
    "cropped": "sensor_msgs/msg/Image",
    "expression": "hri_msgs/msg/Expression",
    "facs": "hri_msgs/msg/FacialActionUnits",
}
"""What is told of a face, in topics of its own, and their types."""
TRANSFORMS: Final = "/tf"
TRANSFORMS_TYPE: Final = "tf2_msgs/msg/TFMessage"

FACE_WIDTH_M: Final = 0.16
"""So wide is a face as detectors frame it; makes a distance of a width in pixels."""
_LANDMARKS: Final = {
    "right_ear": 0, "left_ear": 16, "nose_tip": 30, "right_mouth": 48, "left_mouth": 54,
    "mouth_centre": 62, "right_eye": 68, "left_eye": 69,
}  # fmt: skip
"""Constants of `FacialLandmarks`; the eyes are its pupils, the mouth's centre its inner top."""
_LANDMARK_COUNT: Final = 70
_ACTION_UNIT_COUNT: Final = 99
_ACTION_UNIT: Final = re.compile(r"AU_?0*([0-9]{1,2})", re.IGNORECASE)
_WORDS: Final = {
    "neutral", "angry", "sad", "happy", "surprised", "disgusted", "scared", "pleading",
    "vulnerable", "despaired", "guilty", "disappointed", "embarrassed", "horrified", "skeptical",
    "annoyed", "furious", "suspicious", "rejected", "bored", "tired", "asleep", "confused",
    "amazed", "excited",
}  # fmt: skip
"""Constants of `Expression`."""
_SYNONYMS: Final = {
    "anger": "angry", "sadness": "sad", "happiness": "happy", "joy": "happy", "smile": "happy",
    "surprise": "surprised", "disgust": "disgusted", "fear": "scared", "fearful": "scared",
}  # fmt: skip
"""What recognisers call the same; contempt is none of ROS4HRI's."""
_GAZE: Final[Quaternion] = (-0.5, 0.5, -0.5, 0.5)
"""From the face's frame (x forward, z up) to that of its gaze (z forward, y down)."""
_FACING: Final[Quaternion] = (0.5, 0.5, -0.5, 0.5)
"""From the camera's frame to that of a face that looks into it: its left is the image's right."""


def face_id(track_id: int) -> str:
    """Return the id of a face, a word that may be part of a ROS name."""
    return f"f{track_id:05d}"


def topic(track_id: int, part: str) -> str:
    """Return the topic of a part of a face; see `PARTS`."""
    return f"{FACES}/{face_id(track_id)}/{part}"


def tracked(track_ids: Iterable[int], header: Record) -> Record:
    """Make an `IdsList`."""
    return {"header": header, "ids": [face_id(track_id) for track_id in track_ids]}


def roi(face: Face, faces: Faces, header: Record) -> Record:
    """Make a `NormalizedRegionOfInterest2D`: the part of the box that is in the image."""
    box = face.box
    return {
        "header": header,
        "xmin": _share(box.x, faces.image_width),
        "ymin": _share(box.y, faces.image_height),
        "xmax": _share(box.x + box.width, faces.image_width),
        "ymax": _share(box.y + box.height, faces.image_height),
        "c": _share(face.score, 1),
    }


def landmarks(face: Face, faces: Faces, header: Record) -> Record:
    """Make `FacialLandmarks`; those that are not known have the confidence 0."""
    points: list[Record] = [{}] * _LANDMARK_COUNT
    for name, (x, y) in face.landmarks.items():
        if name in _LANDMARKS:
            points[_LANDMARKS[name]] = {
                "x": _share(x, faces.image_width),
                "y": _share(y, faces.image_height),
                "c": _share(face.score, 1),
            }
    return {
        "header": header,
        "landmarks": points,
        "height": faces.image_height,
        "width": faces.image_width,
    }


def _share(value: float, whole: float) -> float:
    return min(max(value / whole, 0.0), 1.0) if whole else 0.0


def expression(seen: Expression, header: Record) -> Record:
    """Make an `Expression`: the likeliest label that ROS4HRI has a word for.

    Valence and arousal stay 0: nothing here knows them.
    """
    words = {_word(label): share for label, share in seen.labels.items() if _word(label)}
    best = max(words, key=lambda word: words[word], default="")
    return {
        "header": header,
        "expression": best,
        "confidence": _share(words.get(best, 0.0), 1),
    }


def _word(label: str) -> str:
    word = _SYNONYMS.get(label.lower(), label.lower())
    return word if word in _WORDS else ""


def action_units(seen: Expression, header: Record) -> Record:
    """Make `FacialActionUnits` of those that are called `AU1` or `AU01`, by their numbers."""
    intensity, confidence = [0.0] * _ACTION_UNIT_COUNT, [0.0] * _ACTION_UNIT_COUNT
    for name, strength in seen.action_units.items():
        match = _ACTION_UNIT.fullmatch(name)
        if match and int(match[1]) < _ACTION_UNIT_COUNT:
            intensity[int(match[1])] = strength
            confidence[int(match[1])] = 1.0
    return {"header": header, "intensity": intensity, "confidence": confidence}


def transforms(
    face: Face, pose: HeadPose, faces: Faces, field_of_view_deg: float, header: Record
) -> Record:
    """Make a `TFMessage` with the frames `face_<id>` and `gaze_<id>`.

    The direction is that of the head; where it is, is estimated by the size of its box.

    Args:
        face: Which one.
        pose: How its head is turned.
        faces: The image that it is in.
        field_of_view_deg: Of the camera, from the left to the right of its image.
        header: When, and the optical frame of the camera.
    """
    frame = f"face_{face_id(face.track_id)}"
    gaze: Record = {"stamp": header["stamp"], "frame_id": frame}
    place = position_m(face, faces, field_of_view_deg)
    return {
        "transforms": [
            _transform(header, frame, place, orientation(pose)),
            _transform(gaze, f"gaze_{face_id(face.track_id)}", (0.0, 0.0, 0.0), _GAZE),
        ]
    }


def position_m(face: Face, faces: Faces, field_of_view_deg: float) -> Vector3:
    """Estimate where a face is in the camera's optical frame: x right, y down, z away from it."""
    focal_px = faces.image_width / 2 / math.tan(math.radians(field_of_view_deg) / 2)
    m_per_px = FACE_WIDTH_M / max(face.box.width, 1.0)
    x, y = _sellion(face.landmarks, face)
    return (
        (x - faces.image_width / 2) * m_per_px,
        (y - faces.image_height / 2) * m_per_px,
        focal_px * m_per_px,
    )


def _sellion(known: Mapping[str, tuple[float, float]], face: Face) -> tuple[float, float]:
    """Return the point between the eyes, or the middle of the box."""
    if "right_eye" in known and "left_eye" in known:
        (right_x, right_y), (left_x, left_y) = known["right_eye"], known["left_eye"]
        return (right_x + left_x) / 2, (right_y + left_y) / 2
    return face.box.x + face.box.width / 2, face.box.y + face.box.height / 2


def orientation(pose: HeadPose) -> Quaternion:
    """Return how the face's frame (x out of the face, z to the scalp) is turned in the camera's."""
    yaw, pitch, roll = (
        math.radians(angle) / 2 for angle in (-pose.yaw_deg, -pose.pitch_deg, pose.roll_deg)
    )
    turned = _times(
        (0.0, math.sin(yaw), 0.0, math.cos(yaw)), (math.sin(pitch), 0.0, 0.0, math.cos(pitch))
    )
    turned = _times(turned, (0.0, 0.0, math.sin(roll), math.cos(roll)))
    return _times(turned, _FACING)


def _times(first: Quaternion, second: Quaternion) -> Quaternion:
    ax, ay, az, aw = first
    bx, by, bz, bw = second
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _transform(header: Record, child: str, place: Vector3, turned: Quaternion) -> Record:
    return {
        "header": header,
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", place, strict=True)),
            "rotation": dict(zip("xyzw", turned, strict=True)),
        },
    }
