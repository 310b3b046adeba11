"""ROS 2: names, types, bytes and quality of service, and a node of our own in its graph.

All that can be decided without I/O is in `names`, `definitions`, `cdr`, `qos`, `graph` and
`mapping`. How the graph is reached is a driver's: `dds` and `rmw_zenoh` need no ROS, `rclpy` does.
"""
