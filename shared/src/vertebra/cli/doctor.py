"""`doctor`: what is wrong with this machine or the fleet on it, and what mends it."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from typing import Final

import msgspec

from vertebra import __version__
from vertebra.bus import ZenohBus
from vertebra.cli import checks, up
from vertebra.cli.backbone import on_backbone, table
from vertebra.cli.checkout import checkout, state_folder
from vertebra.cli.checks import Finding
from vertebra.cli.fleet import active_variables, read_fleet
from vertebra.cli.processes import is_held
from vertebra.errors import DeadlineError, TransportError
from vertebra.keys import CONTROL_PREFIX
from vertebra.yarp import NameClient, find_name_server

_ROUTER_TIMEOUT_S: Final = 1.5
_CORRECT: Final = "correct VERTEBRA_YARP_NAME_SERVER, or start that name server"
_START: Final = "start the fleet: ./vertebra up"


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser("doctor", help="say what is wrong here and how to mend it")
    on_backbone(parser, _run)


async def _run(arguments: argparse.Namespace) -> int:
    root = checkout()
    findings = [*_of_machine(root)]
    findings += [finding async for finding in _of_backbone(arguments.router)]
    findings += [finding async for finding in _of_yarp(active_variables(root, os.environ))]
    if is_held(up.up_lock(root)):
        findings += checks.check_heartbeats(state_folder(root, "run"))
    print(table([(each.level, each.name, each.text) for each in findings]))
    for each in findings:
        if each.level != "ok":
            print(f"\n{each.name}: {each.text}\n  -> {each.remedy}")
    return int(any(each.level == "wrong" for each in findings))


def _of_machine(root: Path) -> Iterator[Finding]:
    yield checks.check_python()
    text = (root / "compose.yaml").read_text(encoding="utf-8")
    for address in up.listening_addresses(read_fleet(text, active_variables(root, os.environ))):
        yield checks.check_tcp_port(
            address.service, address.variable, address.host, address.tcp_port
        )
        if address.service == "yarp":
            yield checks.check_tcp_server(
                "YARP name server", address.host, address.tcp_port, remedy=_START
            )
    yield checks.check_multicast()
    engine = str(root / "deploy" / "engine")
    for name, command in {
        "Docker engine": [engine, "status"],
        "Docker Compose": ["docker", "compose", "version"],
    }.items():
        remedy = f"only containers need it: {engine} start"
        yield checks.check_command(name, command, remedy=remedy)
    yield checks.check_cameras()
    models = [sys.executable, "-m", "vertebra_face_tracking.models"]
    folder = ["--into", str(up.models_folder(root))]
    fetch = " ".join([*models, "fetch", *folder])
    yield checks.check_command("face models", [*models, "verify", *folder], remedy=fetch)
    chromium = "only tests need it: apt-get install chromium"
    yield checks.check_command("Chromium", ["chromium", "--version"], remedy=chromium)


async def _of_yarp(variables: Mapping[str, str]) -> AsyncIterator[Finding]:
    """Look at the name server that the fleet's YARP adapter uses, if one is there."""
    wanted = variables.get("VERTEBRA_YARP_NAME_SERVER") or variables.get(
        "VERTEBRA_YARP_NAME_SERVER_BIND", "127.0.0.1:10000"
    )
    host, _, tcp_port = wanted.rpartition(":")
    if wanted == "auto":
        names = await find_name_server(variables)
    elif tcp_port.isdecimal():
        names = NameClient(host, int(tcp_port), timeout_s=_ROUTER_TIMEOUT_S)
    else:
        yield Finding("YARP name server", "wrong", f"{wanted!r} is not host:tcp_port", _CORRECT)
        return
    try:
        await names.query("/root")
    except TransportError as error:
        if variables.get("VERTEBRA_YARP_NAME_SERVER"):  # else the fleet brings its own
            yield Finding("YARP name server", "wrong", str(error), _CORRECT)
        return
    yield await checks.check_yarp_address(
        names,
        bind_host=variables.get("VERTEBRA_YARP_BIND_HOST", "127.0.0.1"),
        advertise_host=variables.get("VERTEBRA_YARP_ADVERTISE_HOST", ""),
    )


async def _of_backbone(router: str) -> AsyncIterator[Finding]:
    try:
        bus = await ZenohBus.open(router, timeout_s=_ROUTER_TIMEOUT_S)
    except DeadlineError as error:
        yield Finding("router", "warning", str(error), _START)
        return
    try:
        yield Finding("router", "ok", f"answers at {router}")
        yield checks.check_shared_memory(bus.info().shared_memory)
        info = f"{CONTROL_PREFIX}/services/*/*/info"
        async for reply in bus.query(info, timeout_s=_ROUTER_TIMEOUT_S):
            service = reply.key.split("/")[-3]
            version = str(msgspec.json.decode(reply.payload).get("version"))
            yield checks.check_version(service, version, __version__)
    finally:
        await bus.close()
