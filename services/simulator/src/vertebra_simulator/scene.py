"""What the left camera sees: a person who moves about in a room, from wherever the head looks.

Everything is flat pictures in space, seen through a pinhole: the walls, and the portrait of the
astronaut Eileen Collins (see `pictures/NOTICE.md`), which always faces the robot. Distances are in
metres from the camera, axes as in `geometry`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from vertebra_simulator.geometry import Rotation, Vector, about_z

_NEAREST_M: Final = 0.01
_PIXELS_PER_METRE: Final = 100

# The portrait is a square; the middle of the face lies at these fractions of it.
_PERSON_M: Final = 0.8
_FACE_ACROSS: Final = 0.44
_FACE_DOWN: Final = 0.234


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole without distortion; pixel coordinates begin at the top left corner."""

    width: int = 320
    height: int = 240
    field_of_view_deg: float = 60.0

    @property
    def focal_px(self) -> float:
        """The focal length in pixels; the field of view is horizontal."""
        return self.width / 2 / math.tan(math.radians(self.field_of_view_deg) / 2)

    @property
    def rays(self) -> Rotation:
        """The matrix that turns a pixel `(x, y, 1)` into its direction, from the camera."""
        f = self.focal_px
        return np.array(
            [[0, 0, 1], [-1 / f, 0, self.width / 2 / f], [0, -1 / f, self.height / 2 / f]]
        )

    def project(self, rotation: Rotation, point: Vector) -> tuple[float, float] | None:
        """Return the pixel at which a camera turned by `rotation` sees `point`, if before it."""
        ahead, left, up = (rotation.T @ point).tolist()
        return self.pixel(ahead, left, up) if ahead >= _NEAREST_M else None

    def pixel(self, ahead: float, left: float, up: float) -> tuple[float, float]:
        """Return the pixel at which a point is seen that is given in the camera's frame."""
        f = self.focal_px
        return self.width / 2 - f * left / ahead, self.height / 2 - f * up / ahead


@dataclass(frozen=True, slots=True)
class Person:
    """Where the person's face is: its direction from the robot's rest pose, and its distance."""

    yaw_deg: float
    pitch_deg: float
    distance_m: float

    @property
    def face(self) -> Vector:
        """The middle of the face."""
        pitch = math.radians(self.pitch_deg)
        ahead = np.array([math.cos(pitch), 0.0, math.sin(pitch)]) * self.distance_m
        return np.asarray(about_z(self.yaw_deg) @ ahead)


def person_at(time_s: float) -> Person:
    """Return where the person is: swaying from side to side, up and down, near and far."""
    return Person(
        yaw_deg=15 * math.sin(2 * math.pi * time_s / 19) + 4 * math.sin(2 * math.pi * time_s / 5.3),
        pitch_deg=2 + 3 * math.sin(2 * math.pi * time_s / 13),
        distance_m=0.75 + 0.12 * math.sin(2 * math.pi * time_s / 29),
    )


class Picture:
    """A flat picture in space.

    Args:
        image: What it shows, without transparency.
        corner: Its top left corner.
        across: From there to the top right corner.
        down: From there to the bottom left corner.
        mask: What of it is there; by default everything.
    """

    def __init__(
        self,
        image: Image.Image,
        corner: Vector,
        across: Vector,
        down: Vector,
        mask: Image.Image | None = None,
    ) -> None:
        self.image = image
        self.mask = mask
        self.outline = np.stack([corner, corner + across, corner + across + down, corner + down])
        # A ray meets the plane where `corner + a across + b down` is a multiple of it.
        size = np.array([[image.width], [image.height], [1.0]])
        self.texture_of_ray = size * np.linalg.inv(np.column_stack([across, down, corner]))


class Scene:
    """Renders the room and the person; one frame at a time, from any thread."""

    def __init__(self, camera: Camera | None = None) -> None:
        self.camera = camera or Camera()
        self._room = [*_room()]
        portrait = _portrait()
        self._person_image = portrait.convert("RGB")
        self._person_mask = portrait.getchannel("A")
        self._drawn: tuple[Rotation, Image.Image] = (np.zeros((3, 3)), portrait)

    def render(self, rotation: Rotation, time_s: float) -> Image.Image:
        """Return what a camera turned by `rotation` sees at `time_s`, as an RGB image."""
        image = self._room_from(rotation).copy()
        self._draw(image, rotation, self._person(time_s))
        return image

    def _room_from(self, rotation: Rotation) -> Image.Image:
        """Return what is behind the person; drawn anew only when the head has moved."""
        drawn_for, image = self._drawn
        if not np.array_equal(drawn_for, rotation):
            image = Image.new("RGB", (self.camera.width, self.camera.height), _SHADE)
            for picture in self._room:
                self._draw(image, rotation, picture)
            self._drawn = (rotation, image)
        return image

    def _person(self, time_s: float) -> Picture:
        person = person_at(time_s)
        across = about_z(person.yaw_deg) @ np.array([0.0, -_PERSON_M, 0.0])
        down = np.array([0.0, 0.0, -_PERSON_M])
        corner = person.face - _FACE_ACROSS * across - _FACE_DOWN * down
        return Picture(self._person_image, corner, across, down, self._person_mask)

    def _draw(self, canvas: Image.Image, rotation: Rotation, picture: Picture) -> None:
        polygon = self._polygon(picture.outline @ rotation)
        if not polygon:
            return
        xs, ys = zip(*polygon, strict=True)
        left, right = max(0, math.floor(min(xs))), min(canvas.width, math.ceil(max(xs)))
        top, bottom = max(0, math.floor(min(ys))), min(canvas.height, math.ceil(max(ys)))
        if left >= right or top >= bottom:
            return
        size = (right - left, bottom - top)
        coefficients = self._texture_of_pixel(rotation, picture, left, top)
        drawn = _seen(picture.image, size, coefficients)
        if picture.mask is None:
            mask = Image.new("L", size)
            ImageDraw.Draw(mask).polygon([(x - left, y - top) for x, y in polygon], fill=255)
        else:
            mask = _seen(picture.mask, size, coefficients)
        canvas.paste(drawn, (left, top), mask)

    def _polygon(self, outline: Vector) -> list[tuple[float, float]]:
        """Return the pixels of an outline that is given in the camera's frame, if it is in view."""
        camera = self.camera
        ahead, left, up = outline.T
        across, high = camera.width / 2 / camera.focal_px, camera.height / 2 / camera.focal_px
        sides = (ahead - _NEAREST_M, ahead * across + left, ahead * across - left,
                 ahead * high + up, ahead * high - up)  # fmt: skip
        if any(side.max() < 0 for side in sides):
            return []
        return [camera.pixel(*point) for point in _before_camera(outline.tolist())]

    def _texture_of_pixel(
        self, rotation: Rotation, picture: Picture, left: int, top: int
    ) -> list[float]:
        """Return Pillow's eight numbers that tell which point of `picture` a pixel shows.

        Pixels are counted from `left` and `top`.
        """
        offset = np.array([[1.0, 0, left], [0, 1, top], [0, 0, 1]])
        homography = picture.texture_of_ray @ rotation @ self.camera.rays @ offset
        # Where the first pixel looks exactly along the plane the last number would be 0.
        last = homography[2, 2] or 1e-12
        numbers: list[float] = (homography / last).flat[:8].tolist()
        return numbers


def _seen(texture: Image.Image, size: tuple[int, int], coefficients: list[float]) -> Image.Image:
    return texture.transform(
        size,
        Image.Transform.PERSPECTIVE,
        coefficients,
        Image.Resampling.BILINEAR,
        fillcolor=_SHADE if texture.mode == "RGB" else 0,
    )


def _before_camera(outline: list[list[float]]) -> Iterator[list[float]]:
    """Yield the corners of what is left of a polygon before the camera; x points ahead."""
    for point, after in zip(outline, [*outline[1:], outline[0]], strict=True):
        if point[0] >= _NEAREST_M:
            yield point
        if (point[0] >= _NEAREST_M) != (after[0] >= _NEAREST_M):
            share = (_NEAREST_M - point[0]) / (after[0] - point[0])
            yield [
                _NEAREST_M,
                *(a + share * (b - a) for a, b in zip(point[1:], after[1:], strict=True)),
            ]


def _portrait() -> Image.Image:
    path = resources.files("vertebra_simulator") / "pictures" / "astronaut.webp"
    with path.open("rb") as file, Image.open(file) as image:
        return image.convert("RGBA")


# --- the room --------------------------------------------------------------------------------

_AHEAD_M: Final = 2.5
_ASIDE_M: Final = 2.5
_FLOOR_M: Final = -1.2
_CEILING_M: Final = 1.6
_SHADE: Final = (120, 112, 98)  # between two walls


def _room() -> Iterator[Picture]:
    """Yield the walls, the floor and the ceiling; what is behind the robot it never sees."""
    wide, deep, high = 2 * _ASIDE_M, 2 * _AHEAD_M, _CEILING_M - _FLOOR_M
    front_left = np.array([_AHEAD_M, _ASIDE_M, _CEILING_M])
    front_right = np.array([_AHEAD_M, -_ASIDE_M, _CEILING_M])
    back_left = np.array([-_AHEAD_M, _ASIDE_M, _CEILING_M])
    to_right, ahead, down = np.array([[0, -wide, 0], [deep, 0, 0], [0, 0, -high]])
    yield Picture(_front_wall(wide, high), front_left, to_right, down)
    yield Picture(_left_wall(deep, high), back_left, ahead, down)
    yield Picture(_right_wall(deep, high), front_right, -ahead, down)
    yield Picture(_floor(wide, deep), front_left + down, to_right, -ahead)
    yield Picture(_blank(wide, deep, (214, 212, 205)), back_left, to_right, ahead)


def _blank(width_m: float, height_m: float, color: tuple[int, int, int]) -> Image.Image:
    size = (round(width_m * _PIXELS_PER_METRE), round(height_m * _PIXELS_PER_METRE))
    return Image.new("RGB", size, color)


def _front_wall(width_m: float, height_m: float) -> Image.Image:
    """Return the wall ahead: a window to the left, a clock in the middle, a shelf to the right."""
    wall = _blank(width_m, height_m, (196, 188, 172))
    draw = ImageDraw.Draw(wall)
    draw.rectangle((60, 70, 160, 180), fill=(120, 170, 215), outline=(240, 240, 235), width=6)
    draw.line((110, 70, 110, 180), fill=(240, 240, 235), width=5)
    draw.ellipse((228, 62, 272, 106), fill=(245, 245, 240), outline=(60, 60, 70), width=4)
    draw.line((250, 84, 250, 70), fill=(60, 60, 70), width=3)
    draw.line((250, 84, 261, 89), fill=(60, 60, 70), width=3)
    draw.rectangle((340, 140, 450, 148), fill=(110, 76, 48))
    for count, color in enumerate([(150, 50, 50), (60, 90, 140), (70, 120, 80), (190, 150, 60)]):
        left, top = 350 + 18 * count, 100 + 4 * (count % 2)
        draw.rectangle((left, top, left + 13, 139), fill=color)
    draw.rectangle((0, 272, wall.width, wall.height), fill=(140, 128, 112))
    return wall


def _left_wall(width_m: float, height_m: float) -> Image.Image:
    """Return a wall with a door."""
    wall = _blank(width_m, height_m, (180, 174, 160))
    draw = ImageDraw.Draw(wall)
    draw.rectangle((330, 70, 420, wall.height), fill=(128, 92, 60), outline=(90, 62, 40), width=5)
    draw.ellipse((402, 170, 412, 180), fill=(220, 200, 120))
    return wall


def _right_wall(width_m: float, height_m: float) -> Image.Image:
    """Return a wall with two pictures."""
    wall = _blank(width_m, height_m, (184, 178, 166))
    draw = ImageDraw.Draw(wall)
    draw.rectangle((70, 70, 150, 130), fill=(90, 130, 110), outline=(60, 50, 40), width=5)
    draw.rectangle((190, 60, 250, 150), fill=(170, 110, 80), outline=(60, 50, 40), width=5)
    return wall


def _floor(width_m: float, depth_m: float) -> Image.Image:
    """Return a floor of boards."""
    floor = _blank(width_m, depth_m, (150, 116, 82))
    draw = ImageDraw.Draw(floor)
    for x in range(0, floor.width, 25):
        draw.line((x, 0, x, floor.height), fill=(128, 96, 66), width=2)
    return floor
