"""`yarp`: the tools of a YARP installation, for machines without one.

Words, output and exit status are those of `yarp`; what is no output goes to standard error.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
from collections.abc import Awaitable, Callable
from typing import Final

from vertebra.cli.yarp_streams import read, rpc, write
from vertebra.errors import ConfigError, NotConnectedError
from vertebra.service.logs import configure_logs
from vertebra.yarp.nameserver import NameServer
from vertebra.yarp.naming.clean import Probed, clean
from vertebra.yarp.naming.conf import ROOT, config_path, default_tcp_port
from vertebra.yarp.naming.discovery import find_name_server
from vertebra.yarp.naming.names import Contact, NameClient, ping
from vertebra.yarp.ports.connections import connect, disconnect
from vertebra.yarp.protocol.text import from_text, to_text

_EXIT_INTERRUPTED: Final = 130
_PORT_HELP: Final = "name of a YARP port, such as /camera"

Command = Callable[[argparse.Namespace], Awaitable[int]]
NamesCommand = Callable[[argparse.Namespace, NameClient], Awaitable[int]]


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command and its parts."""
    parser = commands.add_parser("yarp", help="YARP's tools: server, list, read, write, rpc, ...")
    parts = parser.add_subparsers(metavar="TOOL", required=True)

    part = parts.add_parser("server", help="run a name server until Ctrl-C")
    part.add_argument("--ip", default="127.0.0.1", help="listen there (default: %(default)s)")
    part.add_argument("--socket", type=int, metavar="TCP_PORT", help="default: 10000")
    part.add_argument("--namespace", default=ROOT, help="its own name (default: %(default)s)")
    part.add_argument("--write", action="store_true", help="tell YARP programs here: yarp.conf")
    _set_run(part, _server, stopped=0)

    part = parts.add_parser("list", help="list the registered ports")
    part.add_argument("prefix", nargs="?", default="", help="only ports below this name")
    _with_names(part, _list)

    part = parts.add_parser("read", help="print what arrives at a port that is opened for it")
    part.add_argument("port", help=f"{_PORT_HELP}; ... for one that the name server makes up")
    part.add_argument("words", nargs="*", metavar="SOURCE | envelope | once")
    _with_names(part, read, stopped=0)

    part = parts.add_parser("write", help="send lines of standard input from a port")
    part.add_argument("port", help=f"{_PORT_HELP}; ... for one that the name server makes up")
    part.add_argument("targets", nargs="*", help="ports that read it, such as /r or fast_tcp://r")
    _with_names(part, write, stopped=0)

    part = parts.add_parser("rpc", help="call a port with lines of standard input")
    part.add_argument("port", help=_PORT_HELP)
    part.add_argument("--admin", action="store_true", help="talk to the port, not to its owner")
    part.add_argument("--timeout", type=float, default=60.0, metavar="S", help="of each reply")
    _with_names(part, rpc, stopped=0)

    part = parts.add_parser("connect", help="let one port send to another")
    part.add_argument("source", nargs="?", help=_PORT_HELP)
    part.add_argument("dest", nargs="?", help=_PORT_HELP)
    part.add_argument("carrier", nargs="?", help="default: tcp")
    keep = part.add_mutually_exclusive_group()
    for option, mode, text in (
        ("--persist", "", "the name server connects them whenever both are there"),
        ("--persist-from", "from", "the same, as long as the source lives"),
        ("--persist-to", "to", "the same, as long as the dest lives"),
    ):
        keep.add_argument(option, dest="persist", action="store_const", const=mode, help=text)
    _with_names(part, _connect)

    part = parts.add_parser("disconnect", help="end a connection")
    part.add_argument("source", help=_PORT_HELP)
    part.add_argument("dest", help=_PORT_HELP)
    part.add_argument("--persist", action="store_true", help="end what `connect --persist` keeps")
    _with_names(part, _disconnect)

    part = parts.add_parser("ping", help="let a port describe itself")
    part.add_argument("port", help=_PORT_HELP)
    _with_names(part, _ping)

    part = parts.add_parser("clean", help="remove the names of dead ports")
    part.add_argument(
        "--timeout", type=float, default=5.0, metavar="S", help="for each port (default: 5)"
    )
    _with_names(part, _clean)


def _with_names(
    parser: argparse.ArgumentParser, command: NamesCommand, *, stopped: int = _EXIT_INTERRUPTED
) -> None:
    """Let the user say where the name server is."""
    parser.add_argument(
        "--name-server",
        metavar="HOST:TCP_PORT",
        help="default: as YARP finds it (yarp.conf, multicast), else 127.0.0.1:10000",
    )

    async def run(arguments: argparse.Namespace) -> int:
        return await command(arguments, await _names(arguments.name_server))

    _set_run(parser, run, stopped=stopped)


def _set_run(parser: argparse.ArgumentParser, command: Command, *, stopped: int) -> None:
    """Make `command` what `parser` runs; `stopped` is its exit status after Ctrl-C."""
    parser.set_defaults(run=lambda arguments: asyncio.run(_run(command, arguments, stopped)))


async def _run(command: Command, arguments: argparse.Namespace, stopped: int) -> int:
    configure_logs("vertebra", "error", "text")
    loop = asyncio.get_running_loop()
    work = asyncio.ensure_future(command(arguments))
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, work.cancel)
    try:
        return await work
    except asyncio.CancelledError:
        return stopped


async def _names(address: str | None) -> NameClient:
    if address is None:
        return await find_name_server(os.environ)
    host, _, tcp_port = address.rpartition(":")
    if not host or not tcp_port.isdecimal() or not 0 < int(tcp_port) < 65536:
        raise ConfigError(f"{address!r} is not of the form host:tcp_port, such as 127.0.0.1:10000")
    return NameClient(host, int(tcp_port))


async def _server(arguments: argparse.Namespace) -> int:
    udp_port = default_tcp_port(os.environ)
    tcp_port = udp_port if arguments.socket is None else arguments.socket
    async with await NameServer.start(
        bind_host=arguments.ip,
        tcp_port=tcp_port,
        namespace=arguments.namespace,
        discovery_udp_port=udp_port,
    ) as server:
        if arguments.write:
            _write_conf(server.contact)
        print(f"Name server {server.contact.name} at {_uri(server.contact)}")
        print("Ok. Ready!", flush=True)
        await asyncio.Event().wait()
    return 0


def _write_conf(contact: Contact) -> None:
    path = config_path({**os.environ, "YARP_NAMESPACE": contact.name})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{contact.host} {contact.tcp_port} yarp\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error}; leave out --write") from error
    print(f"Wrote {path}")


async def _list(arguments: argparse.Namespace, names: NameClient) -> int:
    for each in await names.list_ports(arguments.prefix):
        print(f"registration name {each.name} ip {each.host} port {each.tcp_port} "
              f"type {each.carrier}")  # fmt: skip
    return 0


async def _connect(arguments: argparse.Namespace, names: NameClient) -> int:
    source, dest, carrier = arguments.source, arguments.dest, arguments.carrier
    if dest is None:
        return await _show_kept(names, source or "")
    if arguments.persist is not None:
        await names.subscribe(source, f"{carrier}:/{dest}" if carrier else dest, arguments.persist)
        return 0
    made = await connect(names, source, dest, carrier or "tcp")
    print(f"Success: Added connection from {made.source} to {made.carrier}:/{made.dest}")
    return 0


async def _show_kept(names: NameClient, name: str) -> int:
    kept = await names.subscriptions(name)
    for source, dest in kept:
        print(f"Persistent connection {source} -> {dest}")
    if not kept:
        print("No persistent connections.")
    return 0


async def _disconnect(arguments: argparse.Namespace, names: NameClient) -> int:
    if arguments.persist:
        await names.unsubscribe(arguments.source, arguments.dest)
        return 0
    gone = await disconnect(names, arguments.source, arguments.dest)
    print(f"Success: Removed connection from {gone.source} to {gone.dest}")
    return 0


async def _ping(arguments: argparse.Namespace, names: NameClient) -> int:
    contact = await names.query(arguments.port)
    if contact is None:
        raise NotConnectedError(
            f"could not find port {arguments.port}; `vertebra yarp list` shows all"
        )
    try:
        lines = await ping(contact, timeout_s=names.timeout_s)
    except NotConnectedError as error:
        raise NotConnectedError(
            f"port found, but cannot connect: {error}; `vertebra yarp clean` removes dead names"
        ) from error
    for line in lines:
        print(to_text(from_text(line)))  # `yarp` reads lines as bottles: names are in quotes
    return 0


async def _clean(arguments: argparse.Namespace, names: NameClient) -> int:
    print("Requesting list of ports from name server... ")
    print(f"Using a timeout of {arguments.timeout:g} seconds")
    async for each in clean(names, timeout_s=arguments.timeout):
        print(_verdict(each), flush=True)
    print("Giving name server a chance to do garbage collection.")
    print(f"Name server says: {await names.collect_garbage()}")
    return 0


def _verdict(probed: Probed) -> str:
    contact = probed.contact
    if probed.verdict == "skipped":
        is_group = contact.carrier == "mcast" and contact.name != "fallback"
        return f"Skipping mcast port {contact.name}..." if is_group else f"Ignoring {contact.name}"
    tested = f"Testing {contact.name} at {_uri(contact)}"
    if probed.verdict == "removed":
        return f"{tested}\n* No response, removing port {contact.name}"
    return tested


def _uri(contact: Contact) -> str:
    return f"{contact.carrier}://{contact.host}:{contact.tcp_port}/"
