"""Who runs what on this machine: processes that hold TCP ports, and one `up` per checkout."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from vertebra.errors import ConfigError

_LISTENING = "0A"  # state TCP_LISTEN in /proc/net/tcp


def tcp_port_is_free(host: str, tcp_port: int) -> bool:
    """Say whether this process could listen there now."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, tcp_port))
            listener.listen()
        except OSError:
            return False
    return True


def holder_of(tcp_port: int) -> str:
    """Name the process that listens on a TCP port, as far as /proc tells us."""
    sockets = set(_listening_sockets(tcp_port))
    for process in Path("/proc").glob("[0-9]*"):
        if sockets & set(_open_files(process)):
            return f"process {process.name} ({_command(process)})"
    return "a process that this user may not see"


def _open_files(process: Path) -> Iterator[str]:
    with contextlib.suppress(OSError):  # it ended in the meantime, or belongs to somebody else
        for descriptor in os.listdir(process / "fd"):  # noqa: PTH208 - complete before one is read
            with contextlib.suppress(FileNotFoundError):
                yield str((process / "fd" / descriptor).readlink())


def _command(process: Path) -> str:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return "ended just now"
    return b" ".join(words).decode(errors="replace").strip()


def _listening_sockets(tcp_port: int) -> Iterator[str]:
    for table in (Path("/proc/net/tcp"), Path("/proc/net/tcp6")):
        if not table.exists():
            continue
        for line in table.read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            if fields[3] == _LISTENING and int(fields[1].rpartition(":")[2], 16) == tcp_port:
                yield f"socket:[{fields[9]}]"


@contextmanager
def only_one(lock: Path) -> Iterator[None]:
    """Hold `lock` while the block runs.

    Raises:
        ConfigError: Another process holds it; the text names that process.
    """
    with lock.open("a+", encoding="ascii") as file:
        if not _try_lock(file):
            file.seek(0)
            pid = file.read().strip()
            raise ConfigError(
                f"the fleet of this checkout runs already (process {pid}); use it, or stop it "
                f"with Ctrl-C there or `kill {pid}`"
            )
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


def is_held(lock: Path) -> bool:
    """Say whether a process holds `lock` now."""
    with lock.open("a", encoding="ascii") as file:
        return not _try_lock(file)


def _try_lock(file: IO[str]) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
