"""Sound in 16-bit samples, one channel after the other."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.objects.parts import TWO_I32, YarpObject, as_bytes, damage, filled, of_type, pack
from vertebra.yarp.protocol.bottle import Buffer
from vertebra.yarp.protocol.dialect import INT16, INT32, LIST, Dialect

_SOUND: Final = struct.Struct("<12i")
_NO_MARKERS: Final = TWO_I32.pack(LIST, 0)


@dataclass(frozen=True, slots=True)
class Sound(YarpObject):
    """A piece of sound in 16-bit samples.

    Attributes:
        frequency_hz: Samples of one channel in a second.
        channels: Their number.
        samples: Planar: all of channel 0, then all of channel 1, ...
        bytes_per_sample: What the microphone gave; on the wire samples always have 16 bits.
        markers: What YARP 4 appends, as it came; not sent to YARP 3, which has no such thing.
    """

    frequency_hz: int
    channels: int
    samples: array[int]
    bytes_per_sample: int = 2
    markers: bytes = _NO_MARKERS

    @property
    def has_markers(self) -> bool:
        """Whether places in the sound are marked."""
        return self.markers != _NO_MARKERS

    def encode(self, dialect: Dialect = Dialect.V3) -> bytes:
        """Return the sound in binary.

        Raises:
            EncodeError: The samples cannot be shared out among the channels.
        """
        length, rest = divmod(len(self.samples), self.channels) if self.channels > 0 else (0, 1)
        if rest:
            raise EncodeError(f"{len(self.samples)} samples are not {self.channels} equal channels")
        is_v4 = dialect is Dialect.V4
        header = pack(
            "sound", _SOUND, LIST, 6 if is_v4 else 5, INT32, length, INT32, self.channels,
            INT32, self.bytes_per_sample, INT32, self.frequency_hz, LIST + INT16, len(self.samples),
        )  # fmt: skip
        return header + as_bytes(of_type("h", self.samples)) + (self.markers if is_v4 else b"")

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the sound in `payload`.

        Raises:
            DecodeError: It holds none.
        """
        if len(payload) < _SOUND.size:
            raise damage(
                "sound", f"{len(payload)} bytes are fewer than its header of {_SOUND.size}"
            )
        (
            *form, length, tag1, channels, tag2, bytes_per_sample, tag3, frequency_hz,
            samples_tag, count,
        ) = _SOUND.unpack_from(payload)  # fmt: skip
        is_v4 = dialect is Dialect.V4
        if (*form, tag1, tag2, tag3, samples_tag) != (
            (LIST, 6 if is_v4 else 5, INT32, INT32, INT32, INT32, LIST + INT16)
        ):
            raise damage("sound", f"its header has not the form of {dialect}")
        end = _SOUND.size + 2 * count
        has_rest = len(payload) >= end + len(_NO_MARKERS) if is_v4 else len(payload) == end
        if count < 0 or channels < 1 or length * channels != count or not has_rest:
            raise damage(
                "sound",
                f"{length} samples x {channels} channels, {count} values announced, "
                f"{len(payload) - _SOUND.size} bytes",
            )
        samples = filled(array("h"), memoryview(payload)[_SOUND.size : end])
        markers = bytes(payload[end:]) or _NO_MARKERS
        return cls(frequency_hz, channels, samples, bytes_per_sample, markers)
