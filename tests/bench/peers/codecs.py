"""One codec in a process of its own: encodes and decodes what it is told, and takes the time.

Each system does what it does when it sends: Vertebra encodes to a frame whose buffers are copied
once, for large messages into memory that is there already (the bus: shared memory); Wrapyfi makes a
JSON text with base64 inside and encodes that as UTF-8 (`publishers/zeromq.py`).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer

from vertebra.bus.shared_memory import THRESHOLD_BYTES
from vertebra.codec import CodecRegistry, Frame
from vertebra.messages import Array, Header, Image, JointState, Message, Tensor

from .peer import answer, orders

JOINTS: Final = {
    "names": ["neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence"],
    "positions_deg": [-12.5, 0.25, 31.75, 4.125, -8.5, 3.0625],
    "velocities_deg_s": [1.5, 0.0, -20.25, 0.5, 12.0, 0.0],
}


class Task(msgspec.Struct, frozen=True):
    """Encode and decode `case` so many times."""

    case: str
    count: int


class Timed(msgspec.Struct, frozen=True):
    """What a task took each time, and the length of the payload."""

    encode_ns: list[int]
    decode_ns: list[int]
    nbytes: int


class Codec(msgspec.Struct, frozen=True):
    """How a system turns a value into a payload and back."""

    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]


def value_of(case: str) -> Any:
    """Return what is sent: joints as a dict of lists, everything else as an array."""
    noise = np.random.default_rng(seed=1)
    if case == "6 joints":
        return JOINTS
    if case == "200 x 200 float64":
        return noise.random((200, 200))
    height, width = {"1080p image": (1080, 1920), "VGA image": (480, 640)}[case]
    return noise.integers(0, 256, (height, width, 3), dtype=np.uint8)


def vertebra(*, reuse: bool) -> Codec:
    codecs = CodecRegistry.installed()
    memory = memoryview(bytearray(16 << 20))

    def encode(value: Any) -> tuple[Buffer, str]:
        frame, encoding = codecs.encode(vertebra_message(value), Header(captured_ns=time.time_ns()))
        if reuse and isinstance(frame, Frame) and frame.nbytes >= THRESHOLD_BYTES:
            position = 0
            for part in frame.parts():
                memory[position : position + len(part)] = part
                position += len(part)
            return memory[:position], encoding
        return bytes(frame), encoding

    def decode(payload: tuple[Buffer, str]) -> Any:
        message, _ = codecs.decode(*payload)
        if isinstance(message, Image):
            return np.asarray(message.pixels)
        return np.asarray(message.array) if isinstance(message, Tensor) else message

    return Codec(encode, decode)


def vertebra_message(value: Any) -> Message:
    if isinstance(value, dict):
        columns: dict[str, Any] = {name: tuple(values) for name, values in value.items()}
        return JointState(**columns)
    array = Array.of(value)
    return Image(pixels=array, pixel_format="rgb8") if value.ndim == 3 else Tensor(array=array)


def wrapyfi() -> Codec:
    from wrapyfi.utils.serialization_encoders import JsonDecodeHook, JsonEncoder

    hook = JsonDecodeHook().object_hook
    return Codec(
        lambda value: json.dumps(value, cls=JsonEncoder, serializer_kwrags={}).encode(),  # sic
        lambda payload: json.loads(payload.decode(), object_hook=hook),
    )


def msgpack() -> Codec:
    def encode(value: Any) -> bytes:
        if isinstance(value, dict):
            return msgspec.msgpack.encode(value)
        return msgspec.msgpack.encode((value.dtype.str, value.shape, value.data))

    def decode(payload: bytes) -> Any:
        value = msgspec.msgpack.decode(payload)
        if isinstance(value, dict):
            return value
        return np.frombuffer(value[2], value[0]).reshape(value[1])

    return Codec(encode, decode)


def json_lists() -> Codec:
    def encode(value: Any) -> bytes:
        return json.dumps(value if isinstance(value, dict) else value.tolist()).encode()

    def decode(payload: bytes) -> Any:
        value = json.loads(payload)
        return value if isinstance(value, dict) else np.array(value)

    return Codec(encode, decode)


CODECS: Final[dict[str, Callable[[], Codec]]] = {
    "vertebra": lambda: vertebra(reuse=True),
    "vertebra-bytes": lambda: vertebra(reuse=False),
    "wrapyfi": wrapyfi,
    "msgpack": msgpack,
    "json": json_lists,
}


def perform(codec: Codec, task: Task) -> Timed:
    """Time a task; the first time, which warms up, also proves that nothing is lost."""
    value = value_of(task.case)
    encode_ns, decode_ns = [], []
    payload: Any = None
    for _ in range(task.count + 1):
        began_ns = time.perf_counter_ns()
        payload = codec.encode(value)
        encoded_ns = time.perf_counter_ns()
        decoded = codec.decode(payload)
        encode_ns.append(encoded_ns - began_ns)
        decode_ns.append(time.perf_counter_ns() - encoded_ns)
        if len(encode_ns) == 1 and not same(decoded, value):
            raise AssertionError(f"{task.case}: something else came out than went in")
    nbytes = len(payload[0] if isinstance(payload, tuple) else payload)
    return Timed(encode_ns[1:], decode_ns[1:], nbytes)


def same(decoded: Any, value: Any) -> bool:
    if isinstance(value, dict):
        fields = decoded if isinstance(decoded, dict) else msgspec.structs.asdict(decoded)
        return all(list(fields[name]) == items for name, items in value.items())
    array: NDArray[Any] = decoded
    return array.shape == value.shape and bool((array == value).all())


if __name__ == "__main__":
    chosen = CODECS[sys.argv[1]]()
    answer("ready")
    for order in orders(Task):
        answer(perform(chosen, order))
