"""The driver `dds`: a ROS 2 node made of the `cyclonedds` wheel, no ROS on the machine.

`driver` is what `vertebra.ros2.driver` asks for; `participant` is DDS and its thread, `services`
what rmw_cyclonedds makes of two topics, `announced` what others are told of types and QoS.
"""
