"""Run the ROS 2 adapter."""

import sys

from vertebra.service import main
from vertebra_ros2.adapter import serve
from vertebra_ros2.settings import Ros2Settings

sys.exit(main("ros2", Ros2Settings, serve))
