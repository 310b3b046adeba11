"""`keys`: what is on the backbone now, and who."""

from __future__ import annotations

import argparse
import asyncio
import time
from collections import Counter

import msgspec

from vertebra.bus import Bus, Delivery, Sample
from vertebra.cli.backbone import backbone, on_backbone, table
from vertebra.codec import CodecRegistry
from vertebra.errors import CodecError
from vertebra.keys import CONTROL_PREFIX, check_key_expression
from vertebra.messages import Status

_SERVICES = f"{CONTROL_PREFIX}/services/*/*"


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser("keys", help="list keys with their rates, and who is there")
    parser.add_argument("key_expression", nargs="?", default="**", metavar="KEYEXPR")
    parser.add_argument(
        "--seconds", type=float, default=2.0, help="how long to listen (default: %(default)g)"
    )
    on_backbone(parser, _run)


async def _run(arguments: argparse.Namespace) -> int:
    check_key_expression(arguments.key_expression)
    async with backbone(arguments.router) as bus:
        seen, services = await asyncio.gather(
            _listen(bus, arguments.key_expression, arguments.seconds),
            _services(bus, arguments.seconds),
        )
    print(seen)
    print()
    print(services)
    return 0


async def _listen(bus: Bus, key_expression: str, seconds: float) -> str:
    newest: dict[str, Sample] = {}
    counts: Counter[str] = Counter()
    async with bus.subscribe(key_expression, Delivery.latest(64)) as samples:
        try:
            async with asyncio.timeout(seconds):
                async for sample in samples:
                    newest[sample.key] = sample
                    counts[sample.key] += 1
        except TimeoutError:
            pass  # the time to listen is over
    if not newest:
        return f"no sample on {key_expression} within {seconds:g} s"
    now_ns = time.time_ns()
    rows = [("KEY", "ENCODING", "RATE", "AGE", "BYTES")]
    for key, sample in sorted(newest.items()):
        age = f"{(now_ns - sample.sent_ns) / 1e6:.0f} ms" if sample.sent_ns else "unknown"
        rate = f"{counts[key] / seconds:.1f} Hz"
        rows.append((key, sample.encoding or "none", rate, age, str(len(sample.payload))))
    return table(rows)


async def _services(bus: Bus, seconds: float) -> str:
    """Return who is present, with the version and the last status of each."""
    codecs = CodecRegistry()
    present: set[str] = set()
    statuses: dict[str, str] = {}
    async with (
        bus.presence(f"{_SERVICES}/alive") as presence,
        bus.subscribe(f"{_SERVICES}/status", Delivery.latest()) as samples,
    ):
        await asyncio.sleep(seconds)
        while (event := presence.take()) is not None:
            (present.add if event.present else present.discard)(event.key.rpartition("/")[0])
        while (sample := samples.take()) is not None:
            statuses[sample.key.rpartition("/")[0]] = _status(codecs, sample)
    versions = {}
    async for reply in bus.query(f"{_SERVICES}/info", timeout_s=1.0):
        info = msgspec.json.decode(reply.payload)
        versions[reply.key.rpartition("/")[0]] = str(info.get("version", ""))
    if not present:
        return "no service is present"
    rows = [("SERVICE", "INSTANCE", "VERSION", "STATUS")]
    for service in sorted(present):
        name, instance = service.split("/")[-2:]
        status = statuses.get(service, "silent")
        rows.append((name, instance, versions.get(service, "no answer"), status))
    return table(rows)


def _status(codecs: CodecRegistry, sample: Sample) -> str:
    try:
        status, _ = codecs.decode(sample.payload, sample.encoding)
    except CodecError as error:
        return f"unreadable: {error}"
    if not isinstance(status, Status):
        return f"unreadable: {type(status).__name__}"
    return f"{status.level}: {status.text}" if status.text else status.level
