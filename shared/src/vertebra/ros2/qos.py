"""Quality of service: what two DDS endpoints must agree on, and what we choose to agree.

A writer offers, a reader requests; they match when nothing that is requested exceeds the offer.
A mismatch is silent on DDS: no sample arrives and nobody is told. So it is decided here.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

from msgspec import Struct

DEPTH: Final = 10
"""What ROS keeps unless told otherwise."""


class Qos(Struct, frozen=True, kw_only=True):
    """The part of a ROS QoS profile that decides who hears whom, and what is kept."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = DEPTH


LATCHED: Final = Qos(durability="transient_local", depth=1)


def mismatch(offered: Qos, requested: Qos) -> str:
    """Return why a writer and a reader do not hear each other, in words; empty if they do."""
    reasons = []
    if requested.reliability == "reliable" and offered.reliability == "best_effort":
        reasons.append("reliability differs: best_effort is offered, reliable is requested")
    if requested.durability == "transient_local" and offered.durability == "volatile":
        reasons.append("durability differs: volatile is offered, transient_local is requested")
    return "; ".join(reasons)


def for_reader(offered: Iterable[Qos], depth: int = DEPTH) -> Qos:
    """Return the strongest request that every one of these writers meets."""
    offers = list(offered)
    best_effort = any(qos.reliability == "best_effort" for qos in offers)
    latched = bool(offers) and all(qos.durability == "transient_local" for qos in offers)
    return Qos(
        reliability="best_effort" if best_effort else "reliable",
        durability="transient_local" if latched else "volatile",
        depth=depth,
    )


def for_writer(requested: Iterable[Qos], depth: int = DEPTH) -> Qos:
    """Return the weakest reliable offer that meets every one of these readers."""
    latched = any(qos.durability == "transient_local" for qos in requested)
    return Qos(durability="transient_local" if latched else "volatile", depth=depth)
