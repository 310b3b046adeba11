"""ROS 2 without ROS: names, types, bytes and quality of service, and a participant on DDS.

All that can be decided without I/O is in `names`, `definitions`, `cdr`, `qos` and `mapping`.
"""
