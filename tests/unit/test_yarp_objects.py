from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.objects import (
    PIXEL_BYTES,
    Image,
    JointData,
    JointModes,
    JointValues,
    LaserScan2D,
    Matrix,
    Measurement,
    Pair,
    PointCloud,
    Quaternion,
    SensorData,
    Sound,
    Stamp,
    Vector,
    kind_of,
    row_bytes,
)
from vertebra.yarp.protocol import bottle
from vertebra.yarp.protocol.bottle import Value, Vocab
from vertebra.yarp.protocol.dialect import Dialect

SENDABLE = sorted(PIXEL_BYTES.keys() - {"rgb-", "hsv."})

both_dialects = pytest.mark.parametrize("dialect", Dialect)
numbers = st.lists(st.floats(allow_nan=False), max_size=20)


def doubles(values: Iterable[float]) -> array[float]:
    return array("d", values)


# --- vectors ---------------------------------------------------------------------------------


@both_dialects
@given(values=numbers)
def test_vectors_come_back(dialect: Dialect, values: list[float]) -> None:
    vector = Vector.of(values)

    assert Vector.decode(vector.encode(dialect), dialect) == vector


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=20))
def test_a_vector_is_the_bottle_of_its_numbers(values: list[float]) -> None:
    assert Vector.of(values).encode() == bottle.encode(values)


def test_arrays_of_other_types_are_converted_or_refused() -> None:
    assert Vector(array("f", [1.5])).encode() == Vector.of([1.5]).encode()
    assert Sound(1, 1, array("i", [7])).encode() == Sound(1, 1, array("h", [7])).encode()
    with pytest.raises(EncodeError, match="an array of 'i' is none of 'h'"):
        Sound(1, 1, array("i", [40_000])).encode()


def test_vectors_of_the_other_dialect_are_refused() -> None:
    with pytest.raises(DecodeError, match=r"begins with 0x114, not 0x10a as in YARP 3"):
        Vector.decode(Vector.of([1.0]).encode(Dialect.V4), Dialect.V3)


@pytest.mark.parametrize("count", [-1, 1, 3, 2**31 - 1])
def test_vectors_with_a_wrong_count_are_refused(count: int) -> None:
    payload = struct.pack("<ii2d", 0x10A, count, 1, 2)

    with pytest.raises(DecodeError, match="were announced, 16 bytes follow"):
        Vector.decode(payload)


@both_dialects
def test_quaternions_are_vectors_of_four(dialect: Dialect) -> None:
    rotation = Quaternion(1.0, 0.0, 0.5, -0.5)

    assert rotation.encode(dialect) == Vector.of([1.0, 0.0, 0.5, -0.5]).encode(dialect)
    assert Quaternion.decode(rotation.encode(dialect), dialect) == rotation
    with pytest.raises(DecodeError, match="3 numbers instead of 4"):
        Quaternion.decode(Vector.of([1, 2, 3]).encode(dialect), dialect)


@both_dialects
@given(rows=st.integers(0, 5), columns=st.integers(0, 5))
def test_matrices_come_back(dialect: Dialect, rows: int, columns: int) -> None:
    matrix = Matrix(rows, columns, doubles(range(rows * columns)))

    assert Matrix.decode(matrix.encode(dialect), dialect) == matrix


def test_matrices_with_missing_values_are_refused() -> None:
    with pytest.raises(EncodeError, match="2 x 3 cannot have 5 values"):
        Matrix(2, 3, doubles(range(5))).encode()
    payload = bytearray(Matrix(2, 3, doubles(range(6))).encode())
    payload[12] = 3
    with pytest.raises(DecodeError, match="6 values instead of 3 x 3"):
        Matrix.decode(payload)


# --- images ----------------------------------------------------------------------------------


@st.composite
def images(draw: st.DrawFn) -> Image:
    pixel_code = draw(st.sampled_from(SENDABLE))
    width, height = draw(st.integers(0, 20)), draw(st.integers(0, 5))
    quantum = draw(st.sampled_from([0, 1, 2, 4, 8, 16]))
    size = row_bytes(width, PIXEL_BYTES[pixel_code], quantum) * height
    return Image(pixel_code, width, height, draw(st.binary(min_size=size, max_size=size)), quantum)


@both_dialects
@given(image=images())
def test_images_come_back(dialect: Dialect, image: Image) -> None:
    assert Image.decode(image.encode(dialect), dialect) == image


@pytest.mark.parametrize(
    ("width", "pixel_bytes", "quantum", "expected"),
    [(3, 3, 8, 16), (320, 3, 8, 960), (5, 1, 4, 8), (3, 3, 1, 9), (3, 3, 0, 9), (0, 3, 8, 0)],
)
def test_rows_are_padded_to_whole_quanta(
    width: int, pixel_bytes: int, quantum: int, expected: int
) -> None:
    assert row_bytes(width, pixel_bytes, quantum) == expected


def test_pixels_are_never_copied() -> None:
    buffer = bytearray(Image("rgb", 8, 2, bytes(48)).encode())
    image = Image.decode(buffer)
    buffer[60] = 7

    assert image.pixels[0] == 7
    assert image.encode_parts()[1] is image.pixels
    assert image.packed_pixels() is image.pixels


def test_padding_is_left_out() -> None:
    padded = Image("rgb", 1, 2, b"abc-----def-----")
    packed = Image.from_packed("rgb", 1, 2, b"abcdef")

    assert padded.packed_pixels() == b"abcdef"
    assert packed.packed_pixels() == b"abcdef"
    assert packed.quantum == 1
    assert Image.from_packed("rgb", 640, 480, bytes(921600)).quantum == 8


def test_the_flag_in_the_upper_half_of_the_quantum_word_is_masked() -> None:
    payload = bytearray(Image("mono", 8, 1, bytes(8)).encode())
    payload[42:44] = b"\1\0"

    assert Image.decode(payload).quantum == 8


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (Image("rgb", 3, 2, bytes(31)), "rows of 16 bytes are 32 bytes, not 31"),
        (Image("rgb", -1, -1, bytes(3), 1), "not 3"),
        (Image("rgb-", 1, 1, bytes(3), 1), "cannot be sent"),
        (Image("xyz", 0, 0, b""), "cannot be sent"),
        (Image("", 1, 1, b"a"), "are 0 bytes, not 1"),
        (Image("mono", 1, 1, b"a", 65536), "cannot be written"),
    ],
)
def test_images_that_would_harm_a_reader_are_not_sent(image: Image, message: str) -> None:
    if message == "cannot be written":
        image = Image("mono", 1, 1, bytes(65536), 65536)
    with pytest.raises(EncodeError, match=message):
        image.encode()


@pytest.mark.parametrize(
    ("offset", "word", "message"),
    [
        (0, 5, "its header has another form"),
        (20, 0x7A7A7A, "unknown pixel code 'zzz'"),
        (32, 4, "4 bytes per pixel of code 'rgb'"),
        (36, 2**31 - 1, "announces 2147483647 and 48"),
        (40, 7, "rows padded to 7 are 56 bytes"),
        (44, 2**31 - 1, "2147483647 x 2"),
        (44, -8, "-8 x 2"),
        (56, 47, "announces 48 and 47"),
    ],
)
def test_images_that_contradict_themselves_are_refused(
    offset: int, word: int, message: str
) -> None:
    payload = bytearray(Image("rgb", 8, 2, bytes(48)).encode())
    struct.pack_into("<i", payload, offset, word)

    with pytest.raises(DecodeError, match=message):
        Image.decode(payload)


# --- stamps, sounds, commands ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("stamp", "text"),
    [
        (Stamp(41, 1234.5), "41 1234.5"),
        (Stamp(0, 1700000000.12346), "0 1700000000.12346"),
        (Stamp(-1, 0.0), "-1 0"),
        (Stamp(7, 1e-7), "7 1e-07"),
    ],
)
def test_stamps_travel_as_envelopes(stamp: Stamp, text: str) -> None:
    assert stamp.to_envelope() == text
    assert Stamp.from_envelope(text) == stamp


@pytest.mark.parametrize("text", [" 41\t1234.5 ", "41 1234.50", "41 +1234.5", "41 1.2345e3"])
def test_envelopes_of_other_writers(text: str) -> None:
    assert Stamp.from_envelope(text) == Stamp(41, 1234.5)


@pytest.mark.parametrize(
    "text",
    ["", "41", "41 x", "x 41", "1 2 3", "1 1.2.3", "1 nan", "1 inf", "1.5 2", "1 1_0", "1 ."],
)
def test_envelopes_that_are_no_stamps(text: str) -> None:
    with pytest.raises(DecodeError, match="not a count and a time"):
        Stamp.from_envelope(text)


@both_dialects
def test_stamps_travel_as_objects(dialect: Dialect) -> None:
    stamp = Stamp(2**31 - 1, 1700000000.25)

    assert Stamp.decode(stamp.encode(dialect), dialect) == stamp
    assert Stamp.decode(Stamp(1, 5).encode(dialect), dialect) == Stamp(1, 5.0)


@pytest.mark.parametrize("values", [[], [1], [1, 2], ["1", 2.0], [1, 2.0, 3], [1, float("nan")]])
def test_bottles_that_are_no_stamps(values: list[Value]) -> None:
    with pytest.raises(DecodeError, match="not a count and a time"):
        Stamp.decode(bottle.encode(values))


@both_dialects
@given(samples=st.lists(st.integers(-(2**15), 2**15 - 1), max_size=10), channels=st.integers(1, 3))
def test_sounds_come_back(dialect: Dialect, samples: list[int], channels: int) -> None:
    sound = Sound(16_000, channels, array("h", samples * channels))

    assert Sound.decode(sound.encode(dialect), dialect) == sound


def test_sounds_with_unequal_channels_are_refused() -> None:
    with pytest.raises(EncodeError, match="3 samples are not 2 equal channels"):
        Sound(16_000, 2, array("h", [1, 2, 3])).encode()
    with pytest.raises(EncodeError, match="0 samples are not 0 equal channels"):
        Sound(16_000, 0, array("h")).encode()


def test_markers_of_yarp_4_are_kept_for_yarp_4() -> None:
    payload = Sound(8000, 1, array("h", [1])).encode(Dialect.V4)[:-4] + b"\1\0\0\0rest"
    sound = Sound.decode(payload, Dialect.V4)

    assert sound.encode(Dialect.V4) == payload
    assert sound.encode(Dialect.V3) == Sound(8000, 1, array("h", [1])).encode(Dialect.V3)


def test_the_command_that_moved_a_real_joint() -> None:
    payload = bytes.fromhex(
        "00010000 02000000 00010000 02000000 09000000 64706f00 01000000 00000000"
        "0a010000 01000000 0000000000002940"
    )
    command = Pair([Vocab("dpo"), 0], Vector.of([12.5]))

    assert command.encode() == payload
    assert Pair.decode(payload) == command


@pytest.mark.parametrize(
    "values", [[], [[1]], ["dpo", [1.0]], [["dpo"], 1.0], [["dpo"], [1.0], 1], [[1], [2]]]
)
def test_bottles_that_are_no_pairs(values: list[Value]) -> None:
    with pytest.raises(DecodeError):
        Pair.decode(bottle.encode(values))


# --- states ----------------------------------------------------------------------------------


def joint_data() -> JointData:
    return JointData(
        joint_position=JointValues(doubles([10.5, -3.0]), ok=True),
        pwm_dutycycle=JointValues(doubles([0.5, 0.25]), ok=True),
        control_mode=JointModes((Vocab("pos"), Vocab("posd")), ok=True),
        interaction_mode=JointModes((Vocab("stif"), Vocab("stif")), ok=True),
    )


@both_dialects
def test_joint_data_comes_back(dialect: Dialect) -> None:
    state = joint_data()

    assert JointData.decode(state.encode(dialect), dialect) == state


def test_only_yarp_4_carries_temperatures() -> None:
    state = JointData(temperature=JointValues(doubles([36.5]), ok=True))

    assert JointData.decode(state.encode(Dialect.V4), Dialect.V4) == state
    assert JointData.decode(state.encode(Dialect.V3), Dialect.V3) == JointData()
    with pytest.raises(DecodeError, match="24 fields instead of 22"):
        JointData.decode(bottle.encode(["x"] * 24), Dialect.V3)


def test_modes_of_more_than_four_letters_are_refused() -> None:
    with pytest.raises(EncodeError, match="at most four letters"):
        JointData(control_mode=JointModes((Vocab("position"),))).encode()


@pytest.mark.parametrize(
    ("position", "value", "message"),
    [
        (0, 1.0, "joint_position is no list of numbers"),
        (0, ["a"], "joint_position is no list of numbers"),
        (1, 7, "the flag of joint_position is 7, neither ok nor fail"),
        (18, [1.5], "control_mode is no list of int32"),
    ],
)
def test_joint_data_with_other_fields_is_refused(position: int, value: Value, message: str) -> None:
    values = bottle.decode(joint_data().encode())
    values[position] = value

    with pytest.raises(DecodeError, match=message):
        JointData.decode(bottle.encode(values))


@both_dialects
def test_sensor_data_comes_back(dialect: Dialect) -> None:
    state = SensorData(
        gyroscopes=(
            Measurement(doubles([1.0, 2.0, 3.0]), 100.25),
            Measurement(doubles([]), 100.5),
        ),
        temperatures=(Measurement(doubles([36.5]), 1.0),),
    )

    assert SensorData.decode(state.encode(dialect), dialect) == state


@pytest.mark.parametrize(
    ("gyroscopes", "message"),
    [
        (1.0, "gyroscopes is no list"),
        ([1.0], "a sensor of gyroscopes is not"),
        ([[[1.0], 1.0, 2.0]], "a sensor of gyroscopes is not"),
        ([[["x"], 1.0]], "gyroscopes is no list of numbers"),
    ],
)
def test_other_sensor_data_is_refused(gyroscopes: Value, message: str) -> None:
    with pytest.raises(DecodeError, match=message):
        SensorData.decode(bottle.encode([gyroscopes, *[[]] * 11]))
    with pytest.raises(DecodeError, match="3 lists, not 12"):
        SensorData.decode(bottle.encode([[]] * 3))


@both_dialects
def test_laser_scans_come_back(dialect: Dialect) -> None:
    scan = LaserScan2D(0.0, 359.0, 0.1, 5.0, doubles([1.0, 2.0]), 1)

    assert LaserScan2D.decode(scan.encode(dialect), dialect) == scan
    with pytest.raises(DecodeError, match="2 values are no scan"):
        LaserScan2D.decode(bottle.encode([1.0, "x"], dialect), dialect)


@both_dialects
def test_point_clouds_come_back_without_being_copied(dialect: Dialect) -> None:
    cloud = PointCloud(2, 1, 2, bytes(range(32)))
    buffer = bytearray(cloud.encode(dialect))
    got = PointCloud.decode(buffer, dialect)
    assert got == cloud
    assert got.point_bytes == 16

    buffer[21] = 99
    assert got.points[0] == 99
    assert got.encode_parts(dialect)[1] is got.points


def test_point_clouds_that_contradict_themselves_are_refused() -> None:
    with pytest.raises(EncodeError, match="31 bytes are not 2 x 1 points"):
        PointCloud(2, 1, 2, bytes(31)).encode()
    with pytest.raises(EncodeError, match="not -1 x -1"):
        PointCloud(-1, -1, 2, bytes(16)).encode()
    with pytest.raises(DecodeError, match="24 bytes follow"):
        PointCloud.decode(PointCloud(2, 1, 2, bytes(24)).encode())
    with pytest.raises(DecodeError, match="not as in"):
        PointCloud.decode(PointCloud(2, 1, 2, bytes(32)).encode(Dialect.V4), Dialect.V3)


# --- what a stream carries -------------------------------------------------------------------


@given(st.binary(max_size=100), st.sampled_from(Dialect))
def test_rubbish_has_a_kind_too(payload: bytes, dialect: Dialect) -> None:
    kind_of(payload, dialect)
    for decode in (Image.decode, Pair.decode, Stamp.decode, Sound.decode, JointData.decode):
        with pytest.raises(DecodeError):
            decode(payload[:59], dialect)


@pytest.mark.parametrize(
    ("payload", "kind"),
    [
        (b"", "unknown"),
        (b"YA\0\0\0\0RP", "unknown"),
        (b"plain text, no bottle at all", "unknown"),
        (bottle.encode([]), "bottle"),
        (bottle.encode(["a", 1, 2, 3]), "bottle"),
        (bottle.encode(["x"] * 22), "bottle"),
        (bottle.encode([["x"]] * 22), "bottle"),
        (bottle.encode([1.0, 2.0]), "vector"),
        (bottle.encode([1.0, 2.0]) + b"x", "bottle"),
        (Image("mono", 8, 1, bytes(8)).encode(), "image"),
        (joint_data().encode(), "joint_data"),
        (SensorData().encode(), "sensor_data"),
        (Sound(8000, 1, array("h", [1])).encode(), "sound"),
        (PointCloud(1, 1, 2, bytes(16)).encode(), "point_cloud"),
        (Pair([1], Vector.of([1.0])).encode(), "bottle"),
    ],
)
def test_a_stream_tells_what_it_carries_by_its_first_message(payload: bytes, kind: str) -> None:
    assert kind_of(payload) == kind
