"""Run the router."""

import sys

from vertebra.service import main
from vertebra_router.adapter import route, serve
from vertebra_router.settings import RouterSettings

sys.exit(main("router", RouterSettings, serve, surround=route))
