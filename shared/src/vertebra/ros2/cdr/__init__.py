"""CDR, the bytes of ROS 2 messages, to plain records and back.

A record is a dict of a type's fields. Numbers, text and booleans stand for themselves, another
type is a record, many numbers are an `Array` that looks at the payload in place, many of anything
else are a list. Written are XCDR1, little endian, as every ROS node does; read is big endian, too.

A type is compiled once into one function for each direction. Large arrays are neither looped over
nor copied, but for the one copy that puts an encoded message together. All lengths are checked
before anything is made of them; damaged bytes are a `DecodeError` that names the field.
"""

from vertebra.ros2.cdr.codec import Cdr
from vertebra.ros2.cdr.parts import HEADER, HEADER_BYTES, PADDING_BYTES

__all__ = ["HEADER", "HEADER_BYTES", "PADDING_BYTES", "Cdr"]
