"""Run the camera."""

import sys

from vertebra.service import main
from vertebra_camera.adapter import serve
from vertebra_camera.settings import CameraSettings

sys.exit(main("camera", CameraSettings, serve))
