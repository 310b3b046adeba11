"""The ROS 2 adapter: topics, services and actions on the backbone."""
