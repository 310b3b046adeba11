"""Encoding and decoding, one codec per process, in turns."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Final

import pytest

from .conftest import Plan
from .peers.codecs import Task, Timed
from .processes import started
from .report import Goal, Report, Table, duration, median

pytestmark = [pytest.mark.bench, pytest.mark.timeout(120)]

SYSTEMS: Final = {
    "vertebra": "Vertebra, into the memory of the bus",
    "vertebra-bytes": "Vertebra, as new bytes",
    "wrapyfi": "Wrapyfi 0.5 (JSON + base64)",
    "msgpack": "MessagePack",
    "json": "JSON lists",
}
CASES: Final = {
    "1080p image": 6_220_800,
    "VGA image": 921_600,
    "200 x 200 float64": 320_000,
    "6 joints": 0,
}
"""Raw bytes of each; a joint state has no raw form."""
REPETITIONS: Final = {"wrapyfi": 4, "json": 2}
JSON_REFUSES: Final = ("1080p image", "VGA image")
"""Seconds each as lists of numbers: nobody does that."""


async def test_codec(plan: Plan, report: Report) -> None:
    timed: dict[str, dict[str, list[Timed]]] = {case: {} for case in CASES}
    async with AsyncExitStack() as stack:
        peers = {name: await stack.enter_async_context(started("codecs", name)) for name in SYSTEMS}
        for _ in range(plan.rounds):
            for case in CASES:
                for name, peer in peers.items():
                    if name == "json" and case in JSON_REFUSES:
                        continue
                    count = REPETITIONS.get(name, 20) * (1 if case in JSON_REFUSES else 5)
                    outcome = await peer.ask(Task(case, count), Timed)
                    timed[case].setdefault(name, []).append(outcome)
    report.raw["codec"] = timed
    for case, raw_bytes in CASES.items():
        rows = [_row(name, outcomes, raw_bytes) for name, outcomes in timed[case].items()]
        columns = ("system", "encode", "decode", "both", "bytes", "more than raw")
        report.tables.append(Table(f"Codec: {case} (median)", columns, rows))
    ours, theirs = timed["1080p image"]["vertebra"], timed["1080p image"]["wrapyfi"]
    ratio = _both_ns(theirs) / _both_ns(ours)
    more = ours[0].nbytes / CASES["1080p image"] - 1
    report.goals += [
        Goal(
            "codec, 1080p image", "Wrapyfi 0.5", ">= 100 x faster", f"{ratio:.0f} x", ratio >= 100
        ),
        Goal("codec, 1080p image", "raw", "<= 0.1 % more bytes", f"{more:.4%}", more <= 0.001),
    ]


def _row(name: str, outcomes: list[Timed], raw_bytes: int) -> tuple[str, ...]:
    nbytes = outcomes[0].nbytes
    return (
        SYSTEMS[name],
        duration(median([ns for outcome in outcomes for ns in outcome.encode_ns])),
        duration(median([ns for outcome in outcomes for ns in outcome.decode_ns])),
        duration(_both_ns(outcomes)),
        f"{nbytes:,}",
        f"{nbytes / raw_bytes - 1:.4%}" if raw_bytes else "",
    )


def _both_ns(outcomes: list[Timed]) -> float:
    """Return the median over all rounds of encoding and decoding together."""
    return median(
        [
            sum(pair)
            for outcome in outcomes
            for pair in zip(outcome.encode_ns, outcome.decode_ns, strict=True)
        ]
    )
