"""How Zenoh's links are set up, alike for the sessions of services and for routers."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Mapping
from typing import Any, Final

import zenoh

from vertebra.errors import ConfigError, DeadlineError

log = logging.getLogger(__name__)

DEFAULT_ROUTER: Final = "tcp/127.0.0.1:7447"
_OPEN_ATTEMPT_MS: Final = 1000

LINK_SETTINGS: Final[dict[str, Any]] = {
    "scouting/multicast/enabled": False,
    # Our own shared memory decides what it can carry; see shared_memory.py.
    "transport/shared_memory/transport_optimization/enabled": False,
    # Batches that wait for a busy link, each 64 KiB at most and made when needed. With Zenoh's two,
    # streams of small samples are dropped whenever a process is not scheduled for a moment; large
    # samples keep few, because a queue of them is only old.
    "transport/link/tx/queue/size": {
        "control": 2,
        "real_time": 2,
        "interactive_high": 16,
        "interactive_low": 2,
        "data_high": 2,
        "data": 16,
        "data_low": 4,
        "background": 2,
    },
}


async def open_client(
    router: str, settings: Mapping[str, Any], *, timeout_s: float | None = None
) -> zenoh.Session:
    """Open a session that is a client of the router at a Zenoh locator, with `settings` of its own.

    Waits for a router that is not there yet, for ever if `timeout_s` is None, and says so in the
    log. The session comes back by itself when the router does.

    Raises:
        ConfigError: `router` is no locator such as `tcp/127.0.0.1:7447`.
        DeadlineError: No router answered within `timeout_s`.
    """
    config = zenoh.Config()
    try:
        for path, value in {
            **LINK_SETTINGS,
            "mode": "client",
            "connect/endpoints": [router],
            "connect/timeout_ms": _OPEN_ATTEMPT_MS,
            "connect/retry": {
                "period_init_ms": 100,
                "period_max_ms": 1000,
                "period_increase_factor": 1.5,
            },
            **settings,
        }.items():
            config.insert_json5(path, json.dumps(value))
    except zenoh.ZError as error:
        raise ConfigError(
            f"{router!r} is no Zenoh locator such as {DEFAULT_ROUTER!r}: {error}"
        ) from error
    deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
    waiting = False
    while True:
        try:
            return await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            if deadline_s is not None and time.monotonic() >= deadline_s:
                raise DeadlineError(f"a Zenoh router at {router}", timeout_s or 0.0) from error
            if not waiting:
                log.warning(
                    "no Zenoh router answers at %s; waiting for it (is the router service up?)",
                    router,
                )
                waiting = True
