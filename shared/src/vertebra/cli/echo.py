"""`echo`: print messages as they arrive."""

from __future__ import annotations

import argparse
import json
import sys
import time
from datetime import UTC, datetime

from vertebra.bus import Delivery, Sample
from vertebra.cli.backbone import as_yaml, backbone, on_backbone, readable
from vertebra.codec import CodecRegistry
from vertebra.errors import CodecError
from vertebra.keys import check_key_expression
from vertebra.messages import Header, Message

_DEPTH = 1024


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser("echo", help="print messages as they arrive")
    parser.add_argument("key_expression", metavar="KEYEXPR")
    parser.add_argument("-n", type=int, metavar="N", help="end after N messages")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="one line of JSON per message")
    form.add_argument("--raw", action="store_true", help="write the payloads as they are")
    parser.add_argument("--encoding", action="store_true", help="show the encodings as well")
    on_backbone(parser, _run)


async def _run(arguments: argparse.Namespace) -> int:
    check_key_expression(arguments.key_expression)
    codecs = CodecRegistry.installed()
    left = arguments.n
    async with (
        backbone(arguments.router) as bus,
        bus.subscribe(arguments.key_expression, Delivery.queue(_DEPTH)) as samples,
    ):
        async for sample in samples:
            if arguments.raw:
                sys.stdout.buffer.write(sample.payload)
                sys.stdout.buffer.flush()
            else:
                _show(sample, codecs, arguments)
            if left is not None:
                left -= 1
                if left <= 0:
                    break
    return 0


def _show(sample: Sample, codecs: CodecRegistry, arguments: argparse.Namespace) -> None:
    try:
        message, header = codecs.decode(sample.payload, sample.encoding)
    except CodecError as error:
        print(f"vertebra: {sample.key}: {error}", file=sys.stderr)
        return
    print(
        _as_json(sample, message, header)
        if arguments.json
        else _as_text(sample, message, header, encoding=arguments.encoding),
        flush=True,
    )


def _as_json(sample: Sample, message: Message, header: Header) -> str:
    document = {
        "key": sample.key,
        "encoding": sample.encoding,
        "captured_ns": header.captured_ns or sample.sent_ns,
        "schema": message.schema(),
        "message": readable(message),
    }
    return json.dumps(document, ensure_ascii=False)


def _as_text(sample: Sample, message: Message, header: Header, *, encoding: bool) -> str:
    captured_ns = header.captured_ns or sample.sent_ns
    parts = [sample.key, type(message).__name__]
    if captured_ns:
        when = datetime.fromtimestamp(captured_ns / 1e9, UTC).astimezone()
        parts.append(f"{when:%H:%M:%S.%f}, {(time.time_ns() - captured_ns) / 1e6:.1f} ms ago")
    if encoding:
        parts.append(sample.encoding)
    return f"--- {', '.join(parts)}\n{as_yaml(readable(message))}"
