"""Turns: of adapters that could do the same work, the one that claimed it first does it.

A claim is a presence on the backbone, so it goes with its adapter, and then the next has its turn.
It counts from `SETTLE_S` on: until then earlier claims have been heard of. Whoever comes back
claims anew and waits behind the others, so nothing changes hands but when somebody goes.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from typing import Final
from urllib.parse import quote

from msgspec import Struct

from vertebra.bus import Bus, Closeable
from vertebra.keys import CONTROL_PREFIX

SETTLE_S: Final = 0.3
_PREFIX: Final = f"{CONTROL_PREFIX}/ros2/turns"


class Claim(Struct, frozen=True, order=True, kw_only=True):
    """Who wants to do a work, and since when; the least has its turn.

    Attributes:
        since_ns: When it was claimed.
        adapter: Identity of the adapter on the backbone.
        domain_id: The ROS domain that it is in.
        participant: What the gids of its endpoints in this domain begin with.
    """

    since_ns: int
    adapter: str
    domain_id: int
    participant: bytes

    def key(self, work: str) -> str:
        """Return the presence that is this claim."""
        return (
            f"{_PREFIX}/{quote(work, safe='')}/{self.since_ns}/{self.adapter}/{self.domain_id}/"
            f"{self.participant.hex() or '-'}"
        )

    @classmethod
    def of(cls, key: str) -> tuple[str, Claim]:
        """Return the work, quoted, and the claim that a presence is."""
        work, since_ns, adapter, domain_id, participant = key[len(_PREFIX) + 1 :].split("/")
        return work, cls(
            since_ns=int(since_ns),
            adapter=adapter,
            domain_id=int(domain_id),
            participant=bytes.fromhex(participant.strip("-")),
        )


class Turns:
    """Claims of all adapters on this backbone."""

    def __init__(
        self, bus: Bus, domain_id: int, participant: bytes, on_change: Callable[[], None]
    ) -> None:
        self._bus = bus
        self._domain_id = domain_id
        self._participant = participant
        self._on_change = on_change
        self._claims: dict[str, set[Claim]] = {}
        self._ours: dict[str, tuple[Claim, Closeable]] = {}
        self._counting: set[str] = set()
        self._presence = bus.presence(f"{_PREFIX}/**")

    async def follow(self) -> None:
        """Hear of the claims of others; runs until cancelled."""
        async for event in self._presence:
            work, claim = Claim.of(event.key)
            if claim.adapter == self._bus.info().identity:
                continue
            known = self._claims.setdefault(work, set())
            (known.add if event.present else known.discard)(claim)
            self._on_change()

    async def claim(self, works: Iterable[str]) -> None:
        """Claim exactly these works; returns when the new claims count."""
        wanted = set(works)
        for work in self._ours.keys() - wanted:
            self._ours.pop(work)[1].close()
        new = wanted - self._ours.keys()
        for work in new:
            claim = Claim(
                since_ns=time.time_ns(),
                adapter=self._bus.info().identity,
                domain_id=self._domain_id,
                participant=self._participant,
            )
            self._ours[work] = (claim, self._bus.declare_presence(claim.key(work)))
        self._counting &= wanted
        if new:
            await asyncio.sleep(SETTLE_S)
        self._counting |= new

    def first(self, work: str) -> Claim | None:
        """Return the first claim of another adapter to a work."""
        return min(self._claims.get(quote(work, safe=""), ()), default=None)

    def is_ours(self, work: str) -> bool:
        """Say whether we do this work: our claim counts, and no other one is before it."""
        if work not in self._counting:
            return False
        first = self.first(work)
        return first is None or self._ours[work][0] < first

    def others(self) -> dict[bytes, Claim]:
        """Return a claim of each other adapter, by its participant."""
        claims = (claim for known in self._claims.values() for claim in known)
        return {claim.participant: claim for claim in claims if claim.participant}

    def close(self) -> None:
        """Give up all claims."""
        self._counting.clear()
        for _, presence in self._ours.values():
            presence.close()
        self._ours.clear()
        self._presence.close()
