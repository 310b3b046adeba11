"""What ROS 2 records mean on the backbone, and back; no I/O.

A type that is listed in `pairs` becomes the message it means, in our units: joint angles and
angular velocities of an `Imu` in degrees. Every other record is a `Native` and goes back as it
came, and so is one of a listed type that its message cannot say, such as joints without positions.
"""

from vertebra.ros2.mapping.media import Sound
from vertebra.ros2.mapping.pairs import to_message, to_record, type_of
from vertebra.ros2.mapping.parts import Record, captured_ns

__all__ = ["Record", "Sound", "captured_ns", "to_message", "to_record", "type_of"]
