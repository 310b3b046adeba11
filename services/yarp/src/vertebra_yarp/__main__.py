"""Run the YARP adapter."""

import sys

from vertebra.service import main
from vertebra_yarp.adapter import serve
from vertebra_yarp.settings import YarpSettings

sys.exit(main("yarp", YarpSettings, serve))
