"""Shared memory for large payloads, as far as this machine allows it.

Zenoh locks its segments in memory: in the publisher, and again in every process that reads them. A
memory-lock limit may forbid that (`OS error 12`), partly as a Rust panic in the middle of a later
`put`; and a reader that cannot lock a segment loses the sample without a word. Hence:

- it is probed once, when the bus opens, and Zenoh's own use of it for plain payloads stays off;
- a pool is made when the first large payload comes, so that who sends none locks none;
- under a limit, no more publishers of a host have a pool than every process there can lock. They
  see each other's by presence; who comes too late sends by copy.
"""

from __future__ import annotations

import contextlib
import logging
import resource
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import zenoh
import zenoh.shm

from vertebra.keys import CONTROL_PREFIX

log = logging.getLogger(__name__)

THRESHOLD_BYTES: Final = 16 << 10
"""Payloads from this size on go through shared memory."""
_POOL_BYTES: Final = 32 << 20
_LIMITED_POOL_BYTES: Final = 2 << 20
_LIMITED_POOLS: Final = 2
_LIMIT_NEEDED_BYTES: Final = 8 << 20  # two pools, each with 1.3 MiB that Zenoh locks beside it
_CLAIM_S: Final = 1.0
_CHUNK_BYTES: Final = 256 << 10
_CAP_IPC_LOCK: Final = 14


class SharedMemory:
    """A pool for the large payloads of one session.

    Attributes:
        description: Whether and how it is used, in words.
        misses: Large payloads that went by copy although it is on.
    """

    def __init__(self, *, enabled: bool) -> None:
        self.description = "off: switched off by the settings"
        self.misses = 0
        self._pool_bytes = 0
        self._max_pools: int | None = None
        self._pool: zenoh.shm.ShmProvider | None = None
        self._session: zenoh.Session | None = None
        self._claims_key = _claims_key()
        self._key = ""
        self._token: zenoh.LivelinessToken | None = None
        self._claimed_at_s = 0.0
        self._seen: set[str] = set()
        self._lock = threading.Lock()
        if enabled:
            self._probe()

    @property
    def available(self) -> bool:
        """Whether segments can be made and read here."""
        return self._pool_bytes > 0

    def _probe(self) -> None:
        limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        unlimited = limit == resource.RLIM_INFINITY or _may_lock_without_limit()
        nbytes = _POOL_BYTES if unlimited else _LIMITED_POOL_BYTES
        remedy = "raise it (ulimit -l, or ulimits.memlock in compose)"
        if not unlimited and limit < _LIMIT_NEEDED_BYTES:
            self.description = f"off: the memory-lock limit is only {limit >> 10} KiB; {remedy}"
            return
        try:
            _make_pool(nbytes)
        except MemoryError as error:
            self.description = f"off: {error}"
            return
        self._pool_bytes = nbytes
        self.description = f"on: {nbytes >> 20} MiB for each publisher"
        if not unlimited:
            self._max_pools = _LIMITED_POOLS
            self.description += (
                f", {_LIMITED_POOLS} publishers at most because of the memory-lock limit of "
                f"{limit >> 20} MiB; {remedy}"
            )

    def join(self, session: zenoh.Session) -> None:
        """Look from now on which other publishers of this host have a pool, if that matters."""
        self._session = session
        if self._max_pools is not None:
            session.liveliness().declare_subscriber(
                f"{self._claims_key}/*", self._changed, history=True
            )

    def _changed(self, sample: zenoh.Sample) -> None:
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._seen.add(str(sample.key_expr))
            else:
                self._seen.discard(str(sample.key_expr))

    def _is_surplus(self) -> bool:
        """Say whether as many others as there may be were first."""
        return self._key not in sorted({*self._seen, self._key})[: self._max_pools]

    def _give_up(self, reason: str) -> None:
        if self._token is not None:
            self._token.undeclare()
        self._token = self._pool = None
        self._pool_bytes = 0
        self.description = f"off: {reason}"
        log.warning("shared memory is %s", self.description)

    def _open_pool(self) -> zenoh.shm.ShmProvider | None:
        """Return the pool, made now if its time has come."""
        with self._lock:
            if self._pool is not None or not self._pool_bytes or self._session is None:
                return self._pool
            if self._token is None:
                # Claim first and wait until everybody has seen it: a reader that once locked the
                # pool of a publisher that has to give way would have no room for another one.
                # Keys sort by the time of the claim, so that who was first stays first.
                self._key = f"{self._claims_key}/{time.time_ns():020d}-{self._session.info.zid()}"
                self._token = self._session.liveliness().declare_token(self._key)
                self._claimed_at_s = time.monotonic()
            if self._max_pools is not None:
                if self._is_surplus():
                    self._give_up(
                        f"{self._max_pools} publishers of this host have as much as the "
                        "memory-lock limit allows; raise it (ulimit -l, or ulimits.memlock in "
                        "compose)"
                    )
                    return None
                if time.monotonic() - self._claimed_at_s < _CLAIM_S:
                    return None
            try:
                self._pool = _make_pool(self._pool_bytes)
            except MemoryError as error:
                self._give_up(str(error))
            return self._pool

    def hold(self, parts: Iterable[bytes | memoryview], nbytes: int) -> zenoh.shm.ZShmMut | None:
        """Return a segment with a copy of `parts`, or None if there is no room for it now."""
        if nbytes < THRESHOLD_BYTES or not self._pool_bytes:
            return None
        pool = self._pool or self._open_pool()
        segment = _allocate(pool, nbytes) if pool is not None else None
        if segment is None:
            self.misses += 1
            return None
        position = 0
        for part in parts:
            # The binding takes only bytes, so memory views go in pieces that fit into a cache.
            step = max(len(part), 1) if isinstance(part, bytes) else _CHUNK_BYTES
            for start in range(0, len(part), step):
                piece = bytes(part[start : start + step])
                segment[position : position + len(piece)] = piece
                position += len(piece)
        return segment


def _make_pool(nbytes: int) -> zenoh.shm.ShmProvider:
    """Return a pool that has proved to work; raise `MemoryError` if there can be none."""
    try:
        pool = zenoh.shm.ShmProvider.default_backend(nbytes)
        pool.alloc(1)  # what Zenoh locks beside the pool is made by the first allocation
    except BaseException as error:  # a Rust panic is no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        raise MemoryError(f"no pool of {nbytes >> 20} MiB can be made: {error}") from error
    return pool


def _allocate(pool: zenoh.shm.ShmProvider, nbytes: int) -> zenoh.shm.ZShmMut | None:
    with contextlib.suppress(zenoh.ZError):
        return pool.alloc(nbytes)
    pool.garbage_collect()
    with contextlib.suppress(zenoh.ZError):
        return pool.alloc(nbytes)
    return None  # readers still hold everything: the caller counts it and sends a copy


def _may_lock_without_limit() -> bool:
    with contextlib.suppress(OSError, StopIteration, ValueError):
        status = Path("/proc/self/status").read_text(encoding="utf-8")
        line = next(line for line in status.splitlines() if line.startswith("CapEff:"))
        return bool(int(line.split()[1], 16) >> _CAP_IPC_LOCK & 1)
    return False  # no procfs: then the limit counts


def _claims_key() -> str:
    host = "unknown"
    with contextlib.suppress(OSError):
        host = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
    return f"{CONTROL_PREFIX}/shared_memory/{host}"
