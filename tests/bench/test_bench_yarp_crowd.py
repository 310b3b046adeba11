"""A YARP port with 200 connections at 50 Hz: what it costs, and that nothing is lost."""

from __future__ import annotations

from typing import Final, Literal

import pytest

from .conftest import Plan
from .crowd import RATE_HZ, SIZE, crowd
from .report import Goal, Report, Table, duration, median, percentile

pytestmark = [pytest.mark.bench, pytest.mark.timeout(300)]

DIRECTIONS: Final[dict[str, Literal["in", "out"]]] = {
    "read by 200 strict readers": "out",
    "written to by 200 writers": "in",
}


async def test_crowded_yarp_ports(plan: Plan, report: Report) -> None:
    rows = []
    for what, direction in DIRECTIONS.items():
        found = await crowd(direction, plan.steady_s)
        exchange = found.exchange
        report.raw[f"yarp crowd, {what}"] = exchange
        rows.append(
            (
                f"one port, {what}",
                f"{exchange.sent_hz:,.0f}/s",
                str(exchange.lost),
                f"{found.cpu:.0%} of a core",
                f"{found.resident_bytes / 1e6:.0f} MB",
                duration(median(exchange.latency_ns)),
                duration(percentile(exchange.latency_ns, 99)),
            )
        )
        measured = f"{exchange.lost} of {exchange.sent:,} lost"
        report.goals.append(
            Goal(f"YARP port {what}, {RATE_HZ:.0f} Hz", "", "no loss", measured, not exchange.lost)
        )
    columns = ("64-byte bottles over tcp", "messages", "lost", "CPU", "memory", "one-way", "p99")
    title = f"YARP port with {SIZE} connections at {RATE_HZ:.0f} Hz for {plan.steady_s:.0f} s"
    report.tables.append(Table(title, columns, rows))
