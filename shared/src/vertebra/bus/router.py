"""A Zenoh router inside a Python process: what the router service and the tests run."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import zenoh

from vertebra.bus.links import LINK_SETTINGS
from vertebra.errors import ConfigError


@contextmanager
def running_router(listen: Sequence[str], connect: Sequence[str] = ()) -> Iterator[None]:
    """Route between the sessions that reach one of the `listen` locators, until the block ends.

    Args:
        listen: Locators such as `tcp/127.0.0.1:7447`.
        connect: Locators of other routers to federate with; they may come and go.

    Raises:
        ConfigError: A locator is malformed or taken.
    """
    config = zenoh.Config()
    try:
        for path, value in {
            **LINK_SETTINGS,
            "mode": "router",
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
        }.items():
            config.insert_json5(path, json.dumps(value))
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise ConfigError(
            f"no router can listen on {', '.join(listen)}: {error}; "
            "is another router running there? Set VERTEBRA_ROUTER_LISTEN to another locator"
        ) from error
    try:
        yield
    finally:
        session.close()
