"""A YARP peer from scratch: bottles and objects, ports, RPC, the name server and its clients.

It speaks to YARP 3 and 4 over the carriers tcp, fast_tcp, text, text_ack and name_ser, and needs
no YARP installation. Images, vectors and stamps are in `objects`.

`wire` knows the bytes that we send and `receiver` those that come, both without I/O; `link` is one
connection, `inputs` and `outputs` are its two sides, `switchboard` all those of a port, `port` its
life; `client` reads and calls ports without being one, and `connections` joins any two.
"""

from __future__ import annotations

from vertebra.yarp.nameserver import NameServer
from vertebra.yarp.naming.discovery import find_name_server
from vertebra.yarp.naming.names import Contact, NameClient
from vertebra.yarp.ports.client import RpcClient
from vertebra.yarp.ports.incoming import Incoming, OnCall, OnData, Reply
from vertebra.yarp.ports.link import Counters, Delivery, Link, PortNotFoundError
from vertebra.yarp.ports.outputs import Payload
from vertebra.yarp.ports.port import Port
from vertebra.yarp.ports.reader import Reader
from vertebra.yarp.ports.sender import Sender
from vertebra.yarp.protocol.bottle import (
    Dict,
    Float32,
    Incomplete,
    Int8,
    Int16,
    Int64,
    Value,
    Vocab,
    Vocab64,
    decode,
    decode_prefix,
    encode,
)
from vertebra.yarp.protocol.dialect import Dialect
from vertebra.yarp.protocol.mjpeg import JpegCodec, installed_jpeg
from vertebra.yarp.protocol.text import from_text, is_complete, to_text
from vertebra.yarp.protocol.wire import PeerLimits

__all__ = [
    "Contact",
    "Counters",
    "Delivery",
    "Dialect",
    "Dict",
    "Float32",
    "Incoming",
    "Incomplete",
    "Int8",
    "Int16",
    "Int64",
    "JpegCodec",
    "Link",
    "NameClient",
    "NameServer",
    "OnCall",
    "OnData",
    "Payload",
    "PeerLimits",
    "Port",
    "PortNotFoundError",
    "Reader",
    "Reply",
    "RpcClient",
    "Sender",
    "Value",
    "Vocab",
    "Vocab64",
    "decode",
    "decode_prefix",
    "encode",
    "find_name_server",
    "from_text",
    "installed_jpeg",
    "is_complete",
    "to_text",
]
