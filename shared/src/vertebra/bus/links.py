"""How Zenoh's links are set up, alike for the sessions of services and for routers."""

from __future__ import annotations

from typing import Any, Final

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
