"""Local programs under supervisor: its configuration, its process, and the logs it writes."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from configparser import RawConfigParser
from pathlib import Path
from typing import IO, Final, Self

from vertebra.cli import launch
from vertebra.cli.fleet import Program
from vertebra.service.run import STOP_WITHIN_S

SUPERVISOR: Final = "supervisor"
_STOPPED_LAST: Final = ("router", "yarp")
"""The others stop before them, all at once, and so can take their leave."""
_KILL_AFTER_S: Final = round(STOP_WITHIN_S) + 2


class Supervisor:
    """Supervisor as a child process: it starts programs, and starts them again when they end.

    Args:
        programs: What to run.
        root: Where they run.
        run: Folder for configuration and pid files.
        log: Folder for one log file per program.
        environment: What all of them inherit.
    """

    def __init__(
        self,
        programs: Sequence[Program],
        *,
        root: Path,
        run: Path,
        log: Path,
        environment: dict[str, str],
    ) -> None:
        configuration = run / "supervisor.conf"
        table = run / "programs.json"
        own = [sys.executable, "-m", "supervisor.supervisord", "-c", str(configuration)]
        entries: dict[str, tuple[Sequence[str], dict[str, str]]] = {
            program.name: (_with_this_python(program.command), program.environment)
            for program in programs
        }
        table.write_text(json.dumps({**entries, SUPERVISOR: (own, {})}), encoding="utf-8")
        with configuration.open("w", encoding="utf-8") as file:
            _configure([program.name for program in programs], root, run, log, table).write(file)
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and file
            _launcher(table, SUPERVISOR),
            cwd=root,
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # a Ctrl-C of the terminal is for `up` alone
        )

    @property
    def runs(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def stop(self) -> int:
        """Stop all programs and itself, in bounded time; return its exit status."""
        self._process.terminate()
        try:
            return self._process.wait(_KILL_AFTER_S + 3)
        except subprocess.TimeoutExpired:
            self._process.kill()  # its programs are told by the kernel, see launch.py
            return self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _with_this_python(command: Sequence[str]) -> list[str]:
    return [sys.executable if command[0] == "python" else command[0], *command[1:]]


def _launcher(table: Path, name: str) -> list[str]:
    return [sys.executable, "-IS", launch.__file__, str(table), name]


def _configure(
    names: Sequence[str], root: Path, run: Path, log: Path, table: Path
) -> RawConfigParser:
    parser = RawConfigParser()
    parser["supervisord"] = {
        "nodaemon": "true",
        "silent": "true",
        "directory": _escaped(root),
        "pidfile": _escaped(run / "supervisor.pid"),
        "logfile": _escaped(log / f"{SUPERVISOR}.log"),
        "logfile_maxbytes": "1MB",
        "logfile_backups": "1",
    }
    if os.geteuid() == 0:
        parser["supervisord"]["user"] = "root"  # else it warns that it is
    others = [name for name in names if name not in _STOPPED_LAST]
    if others:
        parser["group:others"] = {"programs": ",".join(others)}
    for name in names:
        parser[f"program:{name}"] = {
            "priority": str(_STOPPED_LAST.index(name) if name in _STOPPED_LAST else 999),
            "command": _escaped(shlex.join(_launcher(table, name))),
            "autorestart": "true",
            "startretries": "1000000",  # each a second later than the one before
            "stopwaitsecs": str(_KILL_AFTER_S),
            "stopasgroup": "true",
            "killasgroup": "true",
            "redirect_stderr": "true",
            "stdout_logfile": _escaped(log / f"{name}.log"),
            "stdout_logfile_maxbytes": "5MB",
            "stdout_logfile_backups": "2",
        }
    return parser


def _escaped(value: Path | str) -> str:
    return str(value).replace("%", "%%")


class Follower:
    """Reads what is appended to a log file that is rotated by renaming."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rest = ""
        self._file = self._open()
        if self._file is not None:
            self._file.seek(0, os.SEEK_END)

    def lines(self) -> Iterator[str]:
        """Yield the whole lines that were written since the last call."""
        yield from self._read()
        if self._was_rotated():
            self.close()
            self._file = self._open()
            yield from self._read()

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def _open(self) -> IO[str] | None:
        try:
            return self._path.open(encoding="utf-8", errors="replace", newline="\n")
        except FileNotFoundError:
            return None

    def _read(self) -> Iterator[str]:
        if self._file is None:
            return
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        yield from lines

    def _was_rotated(self) -> bool:
        if not self._path.exists():
            return False
        if self._file is None:
            return True
        return self._path.stat().st_ino != os.fstat(self._file.fileno()).st_ino
