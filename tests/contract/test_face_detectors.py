"""One suite for all face detectors, and what each must find besides.

The BlazeFace networks must have been fetched. Where `VERTEBRA_REQUIRE` holds `live` they are
fetched on the way, elsewhere their tests are skipped with the command to run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import vertebra_face_tracking.backend
from vertebra.errors import ConfigError, DecodeError
from vertebra_face_tracking.backend import (
    Detection,
    Detector,
    DetectorOptions,
    RgbImage,
    open_detector,
)
from vertebra_face_tracking.blazeface import LANDMARKS
from vertebra_face_tracking.geometry import iou
from vertebra_face_tracking.models import fetch, load_model

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
MODELS = Path(os.environ.get("VERTEBRA_MODELS") or ROOT / ".vertebra" / "models")
FACE = (172.0, 72.0, 98.0, 98.0)
"""Where the face is in the picture: between what all detectors say."""
GOLDEN: list[dict[str, Any]] = json.loads((DATA / "mediapipe-faces.json").read_text())


def open_backend(name: str, model: str = "", *, min_score: float = 0.5) -> Detector:
    """Open a backend; see the module's words on models."""
    wanted = model or ("blazeface-full-range" if name == "blazeface" else "")
    if wanted:
        if "live" in os.environ.get("VERTEBRA_REQUIRE", "").split(","):
            fetch([wanted], MODELS)
        try:
            load_model(wanted, MODELS)
        except ConfigError as error:
            pytest.skip(str(error))
    return open_detector(name, DetectorOptions(model, MODELS, min_score))


@pytest.fixture(scope="session")
def portrait() -> RgbImage:
    read = cv2.imread(str(DATA / "astronaut.jpg"))
    assert read is not None
    return np.asarray(cv2.cvtColor(read, cv2.COLOR_BGR2RGB), np.uint8)


def boxes_of(found: Sequence[Detection]) -> np.ndarray[Any, np.dtype[np.float64]]:
    rows = [(d.box.x, d.box.y, d.box.width, d.box.height) for d in found]
    return np.array(rows, np.float64).reshape(-1, 4)


def assert_only_face(found: list[Detection], expected: tuple[float, float, float, float]) -> None:
    """Accept one face whose box overlaps `expected` by at least 60 %."""
    assert len(found) == 1, found
    overlap = iou(boxes_of(found), np.array([expected]))[0, 0]
    assert overlap > 0.6, f"{found[0].box} is not at {expected}"


def camera_view(portrait: RgbImage, x: int, y: int) -> RgbImage:
    """Return a 320 x 240 view whose upper left corner is at `x`, `y` of the picture."""
    bordered = cv2.copyMakeBorder(portrait, 320, 320, 320, 320, cv2.BORDER_REPLICATE)
    return np.asarray(bordered[y + 320 : y + 560, x + 320 : x + 640], np.uint8)


def turned(portrait: RgbImage, degrees: float) -> RgbImage:
    """Turn the picture around the middle of the face."""
    x, y, width, height = FACE
    matrix = cv2.getRotationMatrix2D((x + width / 2, y + height / 2), degrees, 1)
    return np.asarray(cv2.warpAffine(portrait, matrix, (512, 512)), np.uint8)


class DetectorSuite:
    """What every face detector does; a backend says only how it is opened."""

    backend: str
    model: str = ""
    false_boxes = 0  # how many it may report beside the face when the view is awkward

    @pytest.fixture
    def detector(self) -> Detector:
        return open_backend(self.backend, self.model)

    def test_it_says_what_it_is(self, detector: Detector) -> None:
        assert isinstance(detector, Detector)
        assert detector.name
        assert detector.version

    def test_it_finds_the_face(self, detector: Detector, portrait: RgbImage) -> None:
        found = detector.detect(portrait)

        assert_only_face(found, FACE)
        assert 0.5 <= found[0].score <= 1

    def test_it_says_the_same_twice(self, detector: Detector, portrait: RgbImage) -> None:
        assert detector.detect(portrait) == detector.detect(portrait)

    def test_it_leaves_the_image_as_it_is(self, detector: Detector, portrait: RgbImage) -> None:
        image = portrait.copy()
        image.flags.writeable = False  # as decoded images are

        assert detector.detect(image)
        assert (image == portrait).all()

    def test_it_finds_the_face_wherever_it_is_in_view(
        self, detector: Detector, portrait: RgbImage
    ) -> None:
        x, y, width, height = FACE
        for left in range(0, 161, 40):
            for top in (-60, -20, 20, 60):
                found = detector.detect(camera_view(portrait, left, top))
                place = np.array([(x - left, y - top, width, height)])
                on_face = iou(boxes_of(found), place)[:, 0] > 0.6
                assert on_face.sum() == 1
                assert (~on_face).sum() <= self.false_boxes

    def test_it_finds_a_grey_face(self, detector: Detector, portrait: RgbImage) -> None:
        grey = cv2.cvtColor(portrait, cv2.COLOR_RGB2GRAY)

        assert_only_face(detector.detect(np.dstack([grey] * 3)), FACE)

    def test_it_finds_the_face_in_a_huge_image(
        self, detector: Detector, portrait: RgbImage
    ) -> None:
        huge = np.asarray(cv2.resize(portrait[:384], (4000, 3000)), np.uint8)
        x, y, width, height = FACE

        assert_only_face(
            detector.detect(huge),
            (x * 4000 / 512, y * 3000 / 384, width * 4000 / 512, height * 3000 / 384),
        )

    def test_it_finds_two_faces(self, detector: Detector, portrait: RgbImage) -> None:
        cut = portrait[:300, 100:400]
        x, y, width, height = FACE

        found = detector.detect(np.hstack([cut, cut[:, ::-1]]))

        assert len(found) == 2
        places = np.array([[x - 100, y, width, height], [700 - x - width, y, width, height]])
        assert iou(boxes_of(found), places).max(axis=1).min() > 0.6

    def test_no_two_boxes_overlap_much(self, detector: Detector, portrait: RgbImage) -> None:
        for scale in (1, 2):
            tile = cv2.resize(portrait[30:230, 120:320], None, fx=scale, fy=scale)
            tiles = np.asarray(np.tile(tile, (2, 3, 1)), np.uint8)
            found = boxes_of(detector.detect(tiles))
            overlaps = iou(found, found) - np.eye(len(found))
            assert overlaps.max(initial=0) <= 0.3

    def test_it_finds_nobody_where_nobody_is(self, detector: Detector) -> None:
        ramp = np.tile(np.arange(256, dtype=np.uint8)[None, :, None], (200, 1, 3))
        for image in (
            np.zeros((240, 320, 3), np.uint8),
            np.full((240, 320, 3), 255, np.uint8),
            ramp,
        ):
            assert detector.detect(image) == []

    def test_it_finds_nobody_in_noise(self, detector: Detector) -> None:
        random = np.random.default_rng(7)
        for _ in range(5):
            noise = random.integers(0, 256, (240, 320, 3)).astype(np.uint8)
            assert detector.detect(noise) == []

    @pytest.mark.parametrize("size", [(1, 1), (1, 400), (400, 1), (3, 2), (19, 19)])
    def test_it_looks_at_tiny_images_too(self, detector: Detector, size: tuple[int, int]) -> None:
        assert detector.detect(np.full((*size, 3), 128, np.uint8)) == []

    @pytest.mark.parametrize("shape", [(0, 0, 3), (0, 320, 3), (240, 0, 3), (240, 320), (9, 9, 4)])
    def test_it_refuses_what_is_no_image(self, detector: Detector, shape: tuple[int, ...]) -> None:
        with pytest.raises(DecodeError):
            detector.detect(np.zeros(shape, np.uint8))

    def test_it_reports_nobody_below_the_asked_score(self, portrait: RgbImage) -> None:
        strict = open_backend(self.backend, self.model, min_score=0.999)

        assert strict.detect(portrait) == []


class BlazeFaceSuite(DetectorSuite):
    """What both networks do besides."""

    backend = "blazeface"

    def test_its_landmarks_lie_on_the_face(self, detector: Detector, portrait: RgbImage) -> None:
        (face,) = detector.detect(portrait)

        points = face.landmarks
        assert tuple(points) == LANDMARKS
        # The person's right is the image's left.
        assert points["right_ear"][0] < points["right_eye"][0] < points["nose_tip"][0]
        assert points["nose_tip"][0] < points["left_eye"][0] < points["left_ear"][0]
        assert points["left_eye"][1] < points["nose_tip"][1] < points["mouth_centre"][1]

    @pytest.mark.parametrize("degrees", [-30, -20, 20, 30])
    def test_it_finds_a_tilted_face(
        self, detector: Detector, portrait: RgbImage, degrees: float
    ) -> None:
        (face,) = found = detector.detect(turned(portrait, degrees))

        assert_only_face(found, FACE)
        right, left = np.array(face.landmarks["right_eye"]), np.array(face.landmarks["left_eye"])
        x, y = left - right
        assert np.degrees(np.arctan2(-y, x)) == pytest.approx(degrees, abs=8)

    def test_it_finds_a_face_that_is_partly_out_of_view(
        self, detector: Detector, portrait: RgbImage
    ) -> None:
        x, _, width, _ = FACE
        left = int(x + width / 3)

        (face,) = detector.detect(portrait[60:300, left : left + 320])

        assert face.box.x < 0  # the box says how much is missing
        assert abs(face.box.x + face.box.width - (x + width - left)) < 0.15 * width

    def test_it_agrees_with_mediapipe(self, detector: Detector, portrait: RgbImage) -> None:
        cases = [case for case in GOLDEN if case["model"] == detector.name]
        assert len(cases) == 5
        for case in cases:
            x, y, width, height = case["crop"]
            (face,) = detector.detect(portrait[y : y + height, x : x + width])

            size = case["box"][2]
            np.testing.assert_allclose(boxes_of([face])[0], case["box"], atol=0.08 * size)
            for name, point in case["landmarks"].items():
                np.testing.assert_allclose(face.landmarks[name], point, atol=0.08 * size)
            assert face.score == pytest.approx(case["score"], abs=0.07)


class TestBlazeFaceFullRange(BlazeFaceSuite):
    model = "blazeface-full-range"

    def test_it_sees_people_who_are_far_away(self, detector: Detector, portrait: RgbImage) -> None:
        """A head of 24 cm is 48 pixels high at 3 m, where a lens shows 60 degrees on 640 pixels."""
        x, y, width, height = FACE
        scale = 48 / 98
        small = np.asarray(
            cv2.resize(portrait, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
        )
        view = np.full((480, 640, 3), 110, np.uint8)
        view[100 : 100 + len(small), 200 : 200 + len(small)] = small

        assert_only_face(
            detector.detect(view),
            (200 + x * scale, 100 + y * scale, width * scale, height * scale),
        )


class TestBlazeFaceShortRange(BlazeFaceSuite):
    model = "blazeface-short-range"


class TestHaar(DetectorSuite):
    backend = "haar"
    false_boxes = 1  # it takes the badge on the suit for a face in some views

    def test_it_has_no_models(self) -> None:
        with pytest.raises(ConfigError, match="'haar' has no models: leave model empty"):
            open_detector("haar", DetectorOptions("blazeface-full-range", MODELS, 0.5))


def test_the_default_model_is_the_full_range_one() -> None:
    assert open_backend("blazeface").name == "blazeface-full-range"


def test_an_unknown_backend_is_an_error_that_lists_the_installed_ones(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match="no face detector 'yolo'; installed are: blazeface, haar"
    ):
        open_detector("yolo", DetectorOptions("", tmp_path, 0.5))


def test_two_backends_of_one_name_are_an_error_that_names_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    group = "vertebra.face_detectors"
    rivals = EntryPoints([EntryPoint("haar", value, group) for value in ("one:open", "two:open")])

    def entry_points(**_: str) -> EntryPoints:
        return rivals

    monkeypatch.setattr(vertebra_face_tracking.backend, "entry_points", entry_points)
    with pytest.raises(ConfigError, match="more than once: one:open, two:open; uninstall"):
        open_detector("haar", DetectorOptions("", tmp_path, 0.5))


def test_an_unknown_model_is_an_error_that_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no model 'x'; it has: blazeface-full-range, blazeface-"):
        open_detector("blazeface", DetectorOptions("x", tmp_path, 0.5))


def test_a_missing_model_is_an_error_that_says_how_to_fetch_it(tmp_path: Path) -> None:
    remedy = f"models fetch blazeface-full-range --into {tmp_path}"
    with pytest.raises(ConfigError, match=f"model missing.*{remedy}"):
        open_detector("blazeface", DetectorOptions("", tmp_path, 0.5))


def test_a_model_of_another_form_is_a_clear_error() -> None:
    from vertebra_face_tracking.blazeface import BlazeFace

    open_backend("blazeface", "blazeface-short-range")
    content = load_model("blazeface-short-range", MODELS)
    with pytest.raises(ConfigError, match=r"maps 1x128x128x3 to 1x896x1, 1x896x16, but .* needs"):
        BlazeFace("blazeface-full-range", content, version="", min_score=0.5)
