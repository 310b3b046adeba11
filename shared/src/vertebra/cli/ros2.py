"""`ros2`: look at a ROS 2 graph and take part in it, on a machine without ROS."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

from vertebra.bus import DEFAULT_ROUTER
from vertebra.errors import ConfigError
from vertebra.ros2.drivers import DriverName
from vertebra.service.logs import configure_logs


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command and its parts."""
    parser = commands.add_parser("ros2", help="ROS 2's tools: topics, services, echo, call, ...")
    parts = parser.add_subparsers(metavar="TOOL", required=True)

    part = parts.add_parser("topics", help="list the topics with their types and endpoints")
    _set_run(part, "topics")
    part = parts.add_parser("services", help="list the services with their types")
    _set_run(part, "services")
    part = parts.add_parser("actions", help="list the actions with their types")
    _set_run(part, "actions")

    part = parts.add_parser("echo", help="print the messages of a topic")
    part.add_argument("name", metavar="TOPIC")
    part.add_argument("--type", default="", help="its type; by default what its publishers say")
    part.add_argument("-n", type=int, metavar="N", help="end after N messages")
    _set_run(part, "echo")

    part = parts.add_parser("pub", help="publish on a topic, once or again and again")
    part.add_argument("name", metavar="TOPIC")
    part.add_argument("type", metavar="TYPE", help="such as std_msgs/msg/String")
    part.add_argument("fields", metavar="JSON", type=_map, help='such as {"data": "hello"}')
    part.add_argument("--rate", type=float, metavar="HZ", help="publish until Ctrl-C")
    _set_run(part, "pub")

    part = parts.add_parser("call", help="call a service and print the answer")
    part.add_argument("name", metavar="SERVICE")
    part.add_argument("fields", metavar="JSON", type=_map, nargs="?", default={})
    part.add_argument("--type", default="", help="its type; by default what its servers say")
    part.add_argument("--timeout", type=float, default=10.0, metavar="S", help="default: 10 s")
    _set_run(part, "call")

    part = parts.add_parser(
        "send_goal", help="send a goal to an action and follow it; Ctrl-C cancels it"
    )
    part.add_argument("name", metavar="ACTION")
    part.add_argument("fields", metavar="JSON", type=_map, nargs="?", default={})
    part.add_argument(
        "--timeout", type=float, metavar="S", help="cancel it after this time (default: never)"
    )
    _set_run(part, "send_goal")

    _add_parameters(parts.add_parser("param", help="the parameters of nodes: list, get, set"))


def _add_parameters(parser: argparse.ArgumentParser) -> None:
    parts = parser.add_subparsers(metavar="WORD", required=True)
    part = parts.add_parser("list", help="list the parameters of a node, or of all")
    part.add_argument("node", metavar="NODE", nargs="?", default="")
    _set_run(part, "param_list")
    part = parts.add_parser("get", help="print parameters of a node, all if none is named")
    part.add_argument("node", metavar="NODE")
    part.add_argument("names", metavar="NAME", nargs="*")
    _set_run(part, "param_get")
    part = parts.add_parser("set", help="set a parameter of a node")
    part.add_argument("node", metavar="NODE")
    part.add_argument("name", metavar="NAME")
    part.add_argument("value", metavar="VALUE", type=_value, help="JSON; what is none is text")
    _set_run(part, "param_set")


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _map(text: str) -> dict[str, Any]:
    try:
        fields = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not JSON: {error}") from error
    if not isinstance(fields, dict):
        raise argparse.ArgumentTypeError(f'{text!r} is not of the form {{"field": value, ...}}')
    return fields


def _driver(text: str) -> str:
    if text not in get_args(DriverName):  # not by `choices`: the default may be faulty as well
        known = ", ".join(get_args(DriverName))
        raise argparse.ArgumentTypeError(f"{text!r} is no driver; there are: {known}")
    return text


def _set_run(parser: argparse.ArgumentParser, tool: str) -> None:
    parser.add_argument(
        "--driver",
        type=_driver,
        metavar="|".join(get_args(DriverName)),
        default=os.environ.get("VERTEBRA_ROS2_DRIVER") or "dds",
        help="how ROS is reached (default: VERTEBRA_ROS2_DRIVER, or dds)",
    )
    parser.add_argument(
        "--domain", type=int, default=None, metavar="N", help="default: ROS_DOMAIN_ID, or 0"
    )
    parser.add_argument(
        "--interface",
        default=os.environ.get("VERTEBRA_ROS2_INTERFACE") or "lo",
        help="network interface, or auto (default: VERTEBRA_ROS2_INTERFACE, or lo)",
    )
    parser.add_argument(
        "--peer", action="append", default=[], metavar="HOST", help="look there without multicast"
    )
    parser.add_argument(
        "--router",
        default=os.environ.get("VERTEBRA_ROS2_ZENOH_ROUTER")
        or os.environ.get("VERTEBRA_ROUTER")
        or DEFAULT_ROUTER,
        metavar="LOCATOR",
        help="Zenoh router of the ROS nodes, for the driver rmw_zenoh (default: VERTEBRA_ROUTER, "
        "or %(default)s)",
    )
    parser.add_argument(
        "--types", action="append", default=[], type=Path, metavar="FOLDER",
        help="ROS packages with types of your own",
    )  # fmt: skip
    parser.add_argument(
        "--wait", type=float, default=1.5, metavar="S",
        help="so long to look for others (default: %(default)g s)",
    )  # fmt: skip
    parser.set_defaults(run=lambda arguments: asyncio.run(_run(tool, arguments)))


async def _run(tool: str, arguments: argparse.Namespace) -> int:
    configure_logs("vertebra", "error", "text")
    if arguments.domain is None:
        text = os.environ.get("ROS_DOMAIN_ID") or "0"
        if not text.isdecimal():
            raise ConfigError(f"ROS_DOMAIN_ID is a number from 0 to 232, not {text!r}")
        arguments.domain = int(text)
    try:
        # Not at the top: DDS and NumPy take their time, which no other command should.
        tools = import_module("vertebra.cli.ros2_tools")
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{error.name} is not installed; it comes with pip install 'vertebra[ros2]'"
        ) from error
    loop = asyncio.get_running_loop()
    work = asyncio.ensure_future(tools.run(tool, arguments))
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, work.cancel)
    try:
        status: int = await work
    except asyncio.CancelledError:
        return 0
    return status
