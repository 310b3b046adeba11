"""Run the face tracking service."""

import sys

from vertebra.service import main
from vertebra_face_tracking.adapter import serve
from vertebra_face_tracking.settings import FaceTrackingSettings

sys.exit(main("face_tracking", FaceTrackingSettings, serve))
