"""`pub`: publish a message, once or again and again."""

from __future__ import annotations

import argparse
import asyncio
import json
import time

import msgspec

from vertebra.bus import Payload
from vertebra.cli.backbone import JSON_ENCODING, backbone, on_backbone, read_json
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError, DecodeError
from vertebra.keys import check_key
from vertebra.messages import MESSAGES, Header, Text

_TYPES = {message.__name__: message for message in MESSAGES}


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser(
        "pub",
        help="publish a message",
        description="Without --type, JSON is published as application/json, all else as text.",
    )
    parser.add_argument("key", metavar="KEY")
    parser.add_argument("message", metavar="MESSAGE", help="text, or JSON")
    parser.add_argument("--type", choices=sorted(_TYPES), help="message type; MESSAGE its fields")
    parser.add_argument("--rate", type=float, metavar="HZ", help="publish until Ctrl-C")
    on_backbone(parser, _run)


async def _run(arguments: argparse.Namespace) -> int:
    if arguments.rate is not None and arguments.rate <= 0:
        raise ConfigError(f"a rate is more than 0 Hz, not {arguments.rate:g}")
    check_key(arguments.key)
    codecs = CodecRegistry.installed()
    encode_payload(codecs, arguments.message, arguments.type)  # complain before anything is opened
    async with backbone(arguments.router) as bus:
        publisher = bus.publisher(arguments.key, encoding="")
        while True:
            payload, encoding = encode_payload(codecs, arguments.message, arguments.type)
            publisher.put(payload, encoding=encoding)
            if arguments.rate is None:
                return 0
            await asyncio.sleep(1 / arguments.rate)


def encode_payload(codecs: CodecRegistry, text: str, type_name: str | None) -> tuple[Payload, str]:
    """Return payload and encoding of what the user typed.

    Raises:
        ConfigError: It is not JSON, or does not fit the message type.
    """
    if type_name is None:
        return text.encode(), JSON_ENCODING if _is_json(text) else "text/plain"
    wanted = _TYPES[type_name]
    fields = {"text": text} if wanted is Text and not _is_json(text) else read_json(text)
    document = msgspec.json.encode({"schema": wanted.schema(), "message": fields})
    try:
        message, _ = codecs.decode(document, JSON_ENCODING)
    except DecodeError as error:
        example = f"its fields are: {', '.join(wanted.__struct_fields__)}"
        raise ConfigError(f"{text} is no {type_name}: {error}; {example}") from error
    return codecs.encode(message, Header(captured_ns=time.time_ns(), origin="cli"))


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except json.JSONDecodeError:
        return False
    return True
