"""What `doctor` looks at, each as a function that returns a finding and changes nothing."""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from vertebra import heartbeat
from vertebra.cli.processes import holder_of, tcp_port_is_free
from vertebra.errors import VertebraError
from vertebra.yarp.naming.addresses import advertised_host, is_loopback, own_addresses
from vertebra.yarp.naming.names import NameClient
from vertebra.yarp.naming.reachability import check_reachability

_ANSWER_TIMEOUT_S: Final = 2.0
_MULTICAST_GROUP: Final = "239.255.76.67"  # in the range that stays on this site
MINIMUM_PYTHON: Final = (3, 11)


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one check; `warning` is something that only some uses of Vertebra need."""

    name: str
    level: Literal["ok", "warning", "wrong"]
    text: str
    remedy: str = ""


def check_python(version: tuple[int, int, int] = sys.version_info[:3]) -> Finding:
    """Check the interpreter."""
    text = ".".join(map(str, version))
    if version[:2] < MINIMUM_PYTHON:
        return Finding(
            "Python", "wrong", text, f"install Python {'.'.join(map(str, MINIMUM_PYTHON))} or newer"
        )
    return Finding("Python", "ok", text)


def check_tcp_port(service: str, variable: str, host: str, tcp_port: int) -> Finding:
    """Check that the fleet can listen on an address, or does so already."""
    name = f"tcp_port {tcp_port} ({service})"
    if tcp_port_is_free(host, tcp_port):
        return Finding(name, "ok", "free")
    holder = holder_of(tcp_port)
    if f"vertebra_{service}" in holder:
        return Finding(name, "ok", f"in use by the fleet: {holder}")
    return Finding(name, "wrong", f"taken by {holder}", f"stop it, or set {variable}")


def check_tcp_server(name: str, host: str, tcp_port: int, *, remedy: str) -> Finding:
    """Check that somebody accepts connections at an address."""
    try:
        socket.create_connection((host, tcp_port), timeout=_ANSWER_TIMEOUT_S).close()
    except OSError as error:
        return Finding(name, "warning", f"{host}:{tcp_port} does not answer: {error}", remedy)
    return Finding(name, "ok", f"answers at {host}:{tcp_port}")


def check_shared_memory(description: str) -> Finding:
    """Judge the description that a bus gives of its shared memory."""
    if description.startswith("on"):
        return Finding("shared memory", "ok", description)
    return Finding("shared memory", "warning", description, "images travel by copy until then")


def check_multicast(interface: str = "127.0.0.1") -> Finding:
    """Check that a datagram to a multicast group comes back on one interface."""
    remedy = "ROS 2 and peers without a router need it: ip link set lo multicast on"
    member = struct.pack("4s4s", socket.inet_aton(_MULTICAST_GROUP), socket.inet_aton(interface))
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.settimeout(_ANSWER_TIMEOUT_S)
        try:
            receiver.bind((_MULTICAST_GROUP, 0))
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            sender.setsockopt(
                socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface)
            )
            sender.sendto(b"vertebra", (_MULTICAST_GROUP, receiver.getsockname()[1]))
            receiver.recv(64)
        except OSError as error:
            return Finding("multicast", "warning", f"does not come back: {error}", remedy)
    return Finding("multicast", "ok", f"works on {interface}")


def check_command(
    name: str, command: Sequence[str], *, remedy: str, timeout_s: float = 10.0
) -> Finding:
    """Check that a command succeeds; the last line it writes is the text."""
    if shutil.which(command[0]) is None:
        return Finding(name, "warning", f"there is no {command[0]} here", remedy)
    try:
        done = subprocess.run(  # noqa: S603 - commands are written in this package
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Finding(
            name, "warning", f"{' '.join(command)} hangs for {timeout_s:g} s already", remedy
        )
    said = (done.stdout.strip() or done.stderr.strip()).splitlines()
    text = said[-1] if said else f"exit status {done.returncode}"
    if done.returncode:
        return Finding(name, "warning", text, remedy)
    return Finding(name, "ok", text)


async def check_yarp_address(
    names: NameClient, *, bind_host: str, advertise_host: str, timeout_s: float = 2.0
) -> Finding:
    """Check that others reach our YARP ports where they are told; takes its own names back."""
    title = "address of YARP ports"
    advertised = advertised_host(advertise_host, bind_host, os.environ, own_addresses())
    try:
        found = await check_reachability(
            names, bind_host=bind_host, advertise_host=advertised, timeout_s=timeout_s
        )
    except (VertebraError, OSError) as error:
        return Finding(title, "warning", f"cannot be tried: {error}", "mend that first")
    if is_loopback(found.told) and not is_loopback(names.host):
        text = f"others are told {found.told}, which is themselves; we are seen at {found.seen}"
    elif not found.reached:
        text = (
            f"others are told {found.told}, where the name server cannot reach us; it sees us at "
            f"{found.seen}"
        )
    elif is_loopback(found.told):
        return Finding(title, "ok", f"{found.told}: for programs on this machine only")
    else:
        return Finding(title, "ok", f"others are told {found.told}; the name server reaches us")
    remedy = (
        "VERTEBRA_YARP_BIND_HOST=0.0.0.0 and VERTEBRA_YARP_ADVERTISE_HOST=<an address of this "
        "machine that others reach>; open its TCP ports; in containers use deploy/compose.lab.yaml"
    )
    return Finding(title, "wrong", text, remedy)


def check_cameras(devices: Path = Path("/dev")) -> Finding:
    """Check the cameras of this machine."""
    found = sorted(devices.glob("video*"))
    if not found:
        return Finding("cameras", "ok", "none here; the simulator brings its own")
    shut = [device for device in found if not os.access(device, os.R_OK | os.W_OK)]
    if shut:
        names = ", ".join(map(str, shut))
        return Finding(
            "cameras",
            "warning",
            f"{names} may not be opened by this user",
            "add the user to the group video and log in again",
        )
    return Finding("cameras", "ok", ", ".join(map(str, found)))


def check_heartbeats(folder: Path) -> list[Finding]:
    """Check the services that run on this machine as processes."""
    findings = []
    for path in sorted(folder.glob("vertebra-*.heartbeat")):
        name = f"service {path.stem.removeprefix('vertebra-')}"
        problem = heartbeat.check(path)
        if problem:
            remedy = f"look into {folder.parent / 'log'}"
            findings.append(Finding(name, "wrong", problem, remedy))
        else:
            findings.append(Finding(name, "ok", "works"))
    return findings


def check_version(service: str, version: str, own: str) -> Finding:
    """Check that a service that is present is of the same version as this command."""
    name = f"{service} on the backbone"
    if version == own:
        return Finding(name, "ok", f"present, version {version}")
    return Finding(
        name, "wrong", f"version {version}, this command is {own}", "restart it from this checkout"
    )
