"""Telling by its bytes what a stream carries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal

from vertebra.errors import DecodeError
from vertebra.yarp.objects.boards import JointData
from vertebra.yarp.objects.clouds import PointCloud
from vertebra.yarp.objects.images import Image
from vertebra.yarp.objects.parts import TWO_I32, YarpObject
from vertebra.yarp.objects.sensors import SensorData
from vertebra.yarp.objects.sounds import Sound
from vertebra.yarp.objects.vectors import Vector
from vertebra.yarp.protocol import bottle
from vertebra.yarp.protocol.bottle import Buffer, Value
from vertebra.yarp.protocol.dialect import LIST, Dialect

Kind = Literal[
    "bottle", "image", "joint_data", "point_cloud", "sensor_data", "sound", "unknown", "vector"
]

# Lists of so many elements may be these objects.
_KIND_BY_COUNT: Final[dict[int, Kind]] = {
    4: "image",
    5: "sound",
    6: "sound",
    12: "sensor_data",
    22: "joint_data",
    24: "joint_data",
}
_DECODERS: Final[dict[Kind, Callable[[Buffer, Dialect], YarpObject]]] = {
    "image": Image.decode,
    "joint_data": JointData.decode,
    "point_cloud": PointCloud.decode,
    "sensor_data": SensorData.decode,
    "sound": Sound.decode,
    "vector": Vector.decode,
}


def kind_of(payload: Buffer, dialect: Dialect = Dialect.V3) -> Kind:
    """Tell what a payload of unknown type is, as far as its bytes show it.

    Stamps, pairs, matrices and scans look like any bottle of such values and count as bottles. A
    bottle of nothing but float64 counts as a vector. Bottles themselves are not read to their end.
    """
    if len(payload) < 8:
        return "unknown"
    tag, count = TWO_I32.unpack_from(payload)
    otherwise: Kind = "bottle" if tag & ~0xFF == LIST else "unknown"
    if tag == LIST:
        kind = _KIND_BY_COUNT.get(count, otherwise)
    elif tag == LIST + dialect.float64:
        kind = "vector"
    else:
        kind = "point_cloud" if otherwise == "unknown" else otherwise
    if kind not in _DECODERS:
        return kind
    try:
        _DECODERS[kind](payload, dialect)
    except DecodeError:
        return otherwise
    return kind


def read(payload: Buffer, dialect: Dialect = Dialect.V3) -> YarpObject | list[Value]:
    """Return the object in a payload of unknown type, or the values of a bottle.

    Raises:
        DecodeError: It is neither.
    """
    decode = _DECODERS.get(kind_of(payload, dialect))
    return decode(payload, dialect) if decode else bottle.decode(payload, dialect)
