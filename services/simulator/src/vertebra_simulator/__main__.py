"""Run the simulator."""

import sys

from vertebra.service import main
from vertebra_simulator.adapter import serve
from vertebra_simulator.settings import SimulatorSettings

sys.exit(main("simulator", SimulatorSettings, serve))
