"""The driver `rmw_zenoh`: a ROS 2 node on Zenoh as `rmw_zenoh_cpp` makes it, with Zenoh alone.

`driver` is what `vertebra.ros2.driver` asks for; `wire` is what crosses the network, decided
without I/O; `session` is Zenoh and our node there, `topics` and `services` stand on it.
"""
