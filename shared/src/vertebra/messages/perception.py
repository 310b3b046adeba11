"""What perception says about an image.

Every result is published with the capture time of the image it was made from, so that it can be
joined to that image and its age is known. Boxes and points are pixels of that image, origin in the
upper left corner.
"""

from __future__ import annotations

from msgspec import Struct, field

from vertebra.messages.message import Message

Point = tuple[float, float]


class Box(Struct, frozen=True, kw_only=True):
    """A rectangle in pixels; `x`, `y` is its upper left corner and may lie outside the image."""

    x: float
    y: float
    width: float
    height: float


class Face(Struct, frozen=True, kw_only=True):
    """One face.

    Attributes:
        track_id: Stays with this face over time; never used for another one.
        box: Where it is.
        score: 0 to 1, as sure as the backend is.
        landmarks: Named points; which ones depends on the backend.
        age_s: How long this track has been followed.
    """

    track_id: int
    box: Box
    score: float
    landmarks: dict[str, Point] = field(default_factory=dict)
    age_s: float = 0.0


class Faces(Message, frozen=True, kw_only=True):
    """All faces in one image; an empty tuple says that the backend looked and found none.

    `frame_id` is the coordinate frame of the camera, as the image has it.
    """

    faces: tuple[Face, ...]
    image_width: int
    image_height: int
    backend: str = ""
    frame_id: str = ""


class Expression(Struct, frozen=True, kw_only=True):
    """Probability of each label and strength (0 to 1) of each action unit, for one face."""

    track_id: int
    labels: dict[str, float]
    action_units: dict[str, float] = field(default_factory=dict)


class Expressions(Message, frozen=True, kw_only=True):
    """Expressions of the faces in one image."""

    expressions: tuple[Expression, ...]
    backend: str = ""


class HeadPose(Struct, frozen=True, kw_only=True):
    """Orientation of one head as the camera sees it.

    Positive yaw looks to the image's right, positive pitch up, positive roll tilts the head's top
    to the image's right.
    """

    track_id: int
    yaw_deg: float
    pitch_deg: float
    roll_deg: float


class HeadPoses(Message, frozen=True, kw_only=True):
    """Head poses of the faces in one image."""

    head_poses: tuple[HeadPose, ...]
    backend: str = ""
