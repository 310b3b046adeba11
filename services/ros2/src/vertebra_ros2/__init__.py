"""The ROS 2 adapter: topics and services on the backbone."""
