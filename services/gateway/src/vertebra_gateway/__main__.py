"""Run the gateway."""

import sys

from vertebra.service import main
from vertebra_gateway.adapter import serve
from vertebra_gateway.settings import GatewaySettings

sys.exit(main("gateway", GatewaySettings, serve))
