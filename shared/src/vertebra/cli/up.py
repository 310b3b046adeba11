"""`up`: run the fleet as processes on this machine until Ctrl-C."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from vertebra import heartbeat
from vertebra.cli.checkout import checkout, state_folder
from vertebra.cli.fleet import (
    Program,
    active_variables,
    interpolate,
    mentioned_variables,
    read_fleet,
)
from vertebra.cli.processes import holder_of, only_one, tcp_port_is_free
from vertebra.cli.supervision import SUPERVISOR, Follower, Supervisor
from vertebra.errors import ConfigError

LISTENERS: Final = {
    "router": ("VERTEBRA_ROUTER_LISTEN", "${VERTEBRA_ROUTER_LISTEN:-tcp/127.0.0.1:7447}"),
    "yarp": (
        "VERTEBRA_YARP_NAME_SERVER_BIND",
        "${VERTEBRA_YARP_NAME_SERVER_BIND:-127.0.0.1:10000}",
    ),
    "gateway": (
        "VERTEBRA_GATEWAY_TCP_PORT",
        "${VERTEBRA_GATEWAY_HOST:-127.0.0.1}:${VERTEBRA_GATEWAY_TCP_PORT:-8080}",
    ),
}
"""Where a service listens: the variable to change it with, and how to tell from its environment."""
OWN_VARIABLES: Final = frozenset({"VERTEBRA_MODELS", "VERTEBRA_REQUIRE", "VERTEBRA_STATE"})
"""Variables that mean something without being handed to a service."""
FOREIGN_NAME_SERVER: Final = "VERTEBRA_YARP_NAME_SERVER"
PATIENCE_S: Final = 60.0
"""After this time the dashboard's address is told even if not all services are well."""
_QUIET_S: Final = 5.0
_LOOK_EVERY_S: Final = 0.1
_ADDRESS: Final = re.compile(r"([\w.-]+):(\d+)")


@dataclass(frozen=True, slots=True)
class Address:
    """Where a service of the fleet listens, and the variable that says so."""

    service: str
    variable: str
    host: str
    tcp_port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.tcp_port}"


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser(
        "up",
        help="run the fleet here",
        description="Run the fleet as processes until Ctrl-C. VERTEBRA_STATE names another folder "
        "than .vertebra for logs and state, so that two fleets can run from one checkout.",
    )
    parser.add_argument(
        "--profile", action="append", default=[], help="profile of compose.yaml to switch on"
    )
    parser.add_argument("service", nargs="*", help="run only these services of compose.yaml")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Start the fleet, wait until it is well, keep it running, stop it."""
    started_s = time.monotonic()
    root = checkout()
    variables = active_variables(root, os.environ)
    text = (root / "compose.yaml").read_text(encoding="utf-8")
    profiles = [*arguments.profile, *os.environ.get("COMPOSE_PROFILES", "").split(",")]
    programs = read_fleet(
        text, variables, profiles=[name for name in profiles if name], services=arguments.service
    )
    with only_one(up_lock(root)):
        _warn_of_unused_variables(text)
        check_addresses(listening_addresses(programs))
        _prepare(root, programs, variables)
        return _run_until_stopped(root, programs, started_s)


def up_lock(root: Path) -> Path:
    """Return the file that a running `up` holds."""
    return state_folder(root, "run") / "up.lock"


def listening_addresses(programs: Sequence[Program]) -> list[Address]:
    """Return everything that the programs listen on for people and other programs."""
    return [
        Address(program.name, variable, host, int(tcp_port))
        for program in programs
        if program.name in LISTENERS and not program.environment.get(FOREIGN_NAME_SERVER)
        for variable, value in [LISTENERS[program.name]]
        for host, tcp_port in _ADDRESS.findall(interpolate(value, program.environment))
    ]


def check_addresses(addresses: Sequence[Address]) -> None:
    """Raise `ConfigError` that names all addresses which are taken, by whom, and the way out."""
    problems = [
        f"{address.service} cannot listen on {address}, which {holder_of(address.tcp_port)} holds; "
        f"stop that one, or set {address.variable} to another address"
        for address in addresses
        if not tcp_port_is_free(address.host, address.tcp_port)
    ]
    if problems:
        raise ConfigError("\n".join(problems))


def _warn_of_unused_variables(compose: str) -> None:
    known = mentioned_variables(compose) | OWN_VARIABLES
    for name in sorted(name for name in os.environ.keys() - known if name.startswith("VERTEBRA_")):
        _say(f"{name} is set, but compose.yaml hands it to no service")


def _prepare(root: Path, programs: Sequence[Program], variables: Mapping[str, str]) -> None:
    names = {program.name for program in programs}
    if "gateway" in names:
        folder = variables.get("VERTEBRA_SECRETS", "deploy/secrets")
        environment = os.environ | {"VERTEBRA_SECRETS": folder}
        command = [str(root / "deploy" / "make-secrets")]
        if subprocess.run(command, cwd=root, env=environment, check=False).returncode:  # noqa: S603
            raise ConfigError(f"no token for the gateway can be made in {folder}; see above")
    if "face_tracking" in names:
        models = models_folder(root)
        fetch = [sys.executable, "-m", "vertebra_face_tracking.models", "fetch"]
        said = subprocess.DEVNULL if any(models.glob("*")) else None  # the first time takes long
        done = subprocess.run([*fetch, "--into", models], stdout=said, check=False)  # noqa: S603
        if done.returncode:
            _say("the face models are missing: the fleet starts without face tracking")


def models_folder(root: Path) -> Path:
    """Return where the face models are kept."""
    return Path(os.environ.get("VERTEBRA_MODELS") or state_folder(root, "models"))


def _welcome(root: Path, programs: Sequence[Program]) -> list[str]:
    lines = []
    for address in listening_addresses(programs):
        if address.service == "gateway":
            host = address.host.replace("0.0.0.0", "127.0.0.1")  # noqa: S104  - told, not bound
            url = f"http://{host}:{address.tcp_port}/{_token_query(root, programs)}"
            lines.append(f"dashboard         {url}")
        elif address.service == "yarp":
            lines.append(f"YARP name server  {address}")
        else:
            lines.append(f"Zenoh router      tcp/{address}")
    return [*lines, f"logs              {state_folder(root, 'log')}", "stop              Ctrl-C"]


def _token_query(root: Path, programs: Sequence[Program]) -> str:
    for program in programs:
        if file := program.environment.get("VERTEBRA_GATEWAY_TOKEN_FILE"):
            try:
                return f"?token={(root / file).read_text(encoding='utf-8').strip()}"
            except OSError as error:
                raise ConfigError(
                    f"the gateway's token cannot be read: {error}; make one with "
                    "deploy/make-secrets, or correct VERTEBRA_GATEWAY_TOKEN_FILE"
                ) from error
    return ""


class _Watch:
    """Shows the logs of the fleet and how it is doing.

    Args:
        names: The programs.
        run: Where they write their heartbeats.
        log: Where supervisor writes their logs.
        welcome: What the user is told once they are up.
    """

    def __init__(self, names: Sequence[str], run: Path, log: Path, welcome: Sequence[str]) -> None:
        self._heartbeats = {name: run / f"vertebra-{name}.heartbeat" for name in names}
        for stale in self._heartbeats.values():
            stale.unlink(missing_ok=True)
        self._logs = {name: Follower(log / f"{name}.log") for name in [*names, SUPERVISOR]}
        self._width = max(map(len, self._logs))
        self._welcome = welcome
        self._welcomed = False
        self._well = False
        self._told: dict[str, str] = {}

    def look(self, age_s: float) -> None:
        """Show what is new since the last call; `age_s` is the age of the fleet."""
        for name, log in self._logs.items():
            for line in log.lines():
                if name != SUPERVISOR or "exited:" in line:
                    print(f"{name:{self._width}} | {line}", flush=True)
        if not self._well:
            self._look_at_heartbeats(age_s)

    def _look_at_heartbeats(self, age_s: float) -> None:
        checks = {name: heartbeat.check(path) for name, path in self._heartbeats.items()}
        problems = {name: problem for name, problem in checks.items() if problem}
        for name, problem in problems.items():
            if age_s > _QUIET_S and self._told.get(name) != problem:
                _say(f"waiting for {name}: {problem}")
                self._told[name] = problem
        if not problems:
            self._well = True
            _say(f"ready after {age_s:.1f} s")
        elif age_s > PATIENCE_S and not self._welcomed:
            _say(f"still waiting for {', '.join(problems)}; the others are up")
        if not self._welcomed and (self._well or age_s > PATIENCE_S):
            self._welcomed = True
            for line in self._welcome:
                _say(f"  {line}")

    def close(self) -> None:
        """Close the logs."""
        for log in self._logs.values():
            log.close()


@contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """Give an event that is set when the user, or a service manager, asks to stop."""
    asked = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: asked.set()) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run_until_stopped(root: Path, programs: Sequence[Program], started_s: float) -> int:
    names = [program.name for program in programs]
    welcome = _welcome(root, programs)
    run_folder, log_folder = state_folder(root, "run"), state_folder(root, "log")
    inherited = {
        name: value for name, value in os.environ.items() if not name.startswith("VERTEBRA_")
    }
    inherited["VERTEBRA_HEARTBEAT_DIR"] = str(run_folder)
    inherited["VERTEBRA_MODELS"] = str(models_folder(root))
    with (
        _stop_signals() as asked,
        closing(_Watch(names, run_folder, log_folder, welcome)) as watch,
        Supervisor(
            programs, root=root, run=run_folder, log=log_folder, environment=inherited
        ) as supervisor,
    ):
        while supervisor.runs and not asked.wait(_LOOK_EVERY_S):
            watch.look(time.monotonic() - started_s)
        status = supervisor.stop()
        watch.look(0.0)
    if not asked.is_set():
        _say(f"supervisor ended by itself with status {status}; see {log_folder}/{SUPERVISOR}.log")
        return 1
    return 0


def _say(text: str) -> None:
    print(f"vertebra: {text}", flush=True)
