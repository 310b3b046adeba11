"""Points in space, as C++ structs behind a header of 21 bytes; the one object that is no bottle."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, Self

from vertebra.errors import EncodeError
from vertebra.yarp.objects.parts import YarpObject, damage, pack
from vertebra.yarp.protocol.bottle import Buffer
from vertebra.yarp.protocol.dialect import LIST, Dialect

_POINT_CLOUD: Final = struct.Struct("<iii?ii")


@dataclass(frozen=True, slots=True)
class PointCloud(YarpObject):
    """Points in space, as C++ structs.

    Attributes:
        width: Points of a row; all of them if they are not in rows.
        height: Number of rows.
        point_type: YARP's number, such as 2 for three float32 padded to 16 bytes.
        points: The structs one after the other.
        is_dense: No point is missing (NaN).
    """

    width: int
    height: int
    point_type: int
    points: Buffer
    is_dense: bool = True

    @property
    def point_bytes(self) -> int:
        """The size of one point, padding included; 0 if there is none."""
        count = self.width * self.height
        return memoryview(self.points).nbytes // count if count else 0

    def encode_parts(self, dialect: Dialect = Dialect.V3) -> list[Buffer]:
        """Return header and points, to be sent one after the other; the points are not copied.

        Raises:
            EncodeError: There are not width x height points of the same size.
        """
        count = self.width * self.height
        size = memoryview(self.points).nbytes
        if min(self.width, self.height) < 0 or self.point_bytes * count != size:
            raise EncodeError(f"{size} bytes are not {self.width} x {self.height} points")
        header = pack(
            "point cloud", _POINT_CLOUD, self.width, self.height, self.point_type, self.is_dense,
            LIST + dialect.float64, count,
        )  # fmt: skip
        return [header, self.points]

    @classmethod
    def decode(cls, payload: Buffer, dialect: Dialect = Dialect.V3) -> Self:
        """Return the cloud in `payload`; its points are a view of that buffer.

        Raises:
            DecodeError: It holds none.
        """
        if len(payload) < _POINT_CLOUD.size:
            raise damage("point cloud", f"{len(payload)} bytes are too few")
        width, height, point_type, is_dense, tag, count = _POINT_CLOUD.unpack_from(payload)
        points = memoryview(payload)[_POINT_CLOUD.size :]
        if tag != LIST + dialect.float64:
            raise damage("point cloud", f"its points begin with {tag:#x}, not as in {dialect}")
        cloud = cls(width, height, point_type, points, is_dense)
        expected = _POINT_BYTES.get(point_type, cloud.point_bytes) * count
        if min(width, height) < 0 or width * height != count or len(points) != expected:
            raise damage(
                "point cloud",
                f"{width} x {height} points of type {point_type} announced, then {count}; "
                f"{len(points)} bytes follow",
            )
        return cloud


_POINT_BYTES: Final = {2: 16, 0x02000006: 32}
