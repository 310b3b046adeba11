"""The Zenoh router of the fleet, for both Vertebra and the programs that speak Zenoh by hand."""

from __future__ import annotations

import sys

from vertebra.bus.router import running_router

from .peer import Stream, answer, main


def route(stream: Stream) -> None:
    with running_router([stream.endpoint]):
        answer("ready")
        sys.stdin.read()


if __name__ == "__main__":
    main({"route": route})
