"""The driver `rclpy`: a node of the lab's own ROS 2, whatever middleware it runs on.

It reaches what the driver `dds` cannot, such as the services and actions of Fast DDS nodes.
`driver` is what `vertebra.ros2.driver` asks for; `node` is rclpy's node and its thread, `watch` how
the graph is seen, `services` and `classes` what ROS has made of services and types.
"""
