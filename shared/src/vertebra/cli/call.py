"""`call`: call a key and print the answer."""

from __future__ import annotations

import argparse
import json

from vertebra.bus import Reply
from vertebra.cli.backbone import JSON_ENCODING, as_yaml, backbone, on_backbone, read_json, readable
from vertebra.codec import CodecRegistry
from vertebra.keys import check_key


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser("call", help="call a key and print the answer")
    parser.add_argument("key", metavar="KEY")
    parser.add_argument("argument", nargs="?", metavar="JSON", help="what to hand over")
    parser.add_argument(
        "--timeout", type=float, default=10.0, metavar="S", help="default: %(default)g s"
    )
    on_backbone(parser, _run)


async def _run(arguments: argparse.Namespace) -> int:
    check_key(arguments.key)
    payload, encoding = b"", ""
    if arguments.argument is not None:
        payload, encoding = json.dumps(read_json(arguments.argument)).encode(), JSON_ENCODING
    async with backbone(arguments.router) as bus:
        reply = await bus.call(
            arguments.key, payload, encoding=encoding, timeout_s=arguments.timeout
        )
    print(_show(reply))
    return 0


def _show(reply: Reply) -> str:
    if reply.encoding == JSON_ENCODING:
        return json.dumps(json.loads(reply.payload), indent=2, ensure_ascii=False)
    if not reply.payload:
        return "(an empty answer)"
    message, _ = CodecRegistry.installed().decode(reply.payload, reply.encoding)
    return as_yaml(readable(message))
