"""The fleet in containers, as a test handles it: end and start services, read their logs."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from testcontainers.compose import DockerCompose

ROOT: Final = Path(__file__).parents[2]
POLL_S: Final = 0.1


def run(*command: str | Path, timeout_s: float = 60.0) -> str:
    """Return what a command prints; fail with all that it complains about."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=ROOT, capture_output=True, text=True, timeout=timeout_s, check=False
    )
    if done.returncode:
        problem = f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
        raise AssertionError(problem)
    return done.stdout


@dataclass(frozen=True, slots=True)
class Fleet:
    """A running fleet; `url` and `token` are those of its gateway."""

    url: str
    token: str
    compose: DockerCompose

    def services(self) -> list[str]:
        """Return the names of all services, of stopped ones too."""
        return sorted(str(c.Service) for c in self.compose.get_containers(include_all=True))

    def logs(self, service: str) -> str:
        """Return all that a service has logged since its container was made."""
        return self._compose("logs", "--no-color", "--no-log-prefix", "--timestamps", service)

    def inside(self, service: str, *command: str) -> str:
        """Return what a command prints that runs in the container of a service."""
        return self._compose("exec", "-T", service, *command)

    def crash(self, service: str) -> None:
        """End the processes of a service without warning; the engine starts it anew."""
        before = self._state(service)["StartedAt"]
        # The shell ends all that it may, which spares itself and the container's init. With its
        # child gone, init ends too; whether the shell gets to tell its end is a race.
        self.inside(service, "sh", "-c", "kill -KILL -1; true")
        self._wait(lambda: self._state(service)["StartedAt"] != before, f"{service} starts anew")

    def kill(self, service: str) -> None:
        """End the container of a service without warning; it stays away until `start`."""
        self._compose("kill", service)

    def start(self, service: str) -> None:
        """Start a service that was killed, without waiting for its health."""
        self._compose("start", service)

    def wait_healthy(self, service: str, *, timeout_s: float = 30.0) -> None:
        """Wait for the next good health check of a service."""
        self._wait(
            lambda: self._state(service)["Health"]["Status"] == "healthy",
            f"{service} is healthy",
            timeout_s=timeout_s,
        )

    def _compose(self, *arguments: str) -> str:
        return run(*self.compose.compose_command_property, *arguments)

    def _state(self, service: str) -> dict[str, Any]:
        container = self._compose("ps", "--all", "--quiet", service).strip()
        state: dict[str, Any] = json.loads(
            run("docker", "inspect", "--format", "{{json .State}}", container)
        )
        return state

    def _wait(self, condition: Callable[[], bool], what: str, *, timeout_s: float = 30.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= deadline_s:
                raise AssertionError(f"not within {timeout_s:g} s: {what}")
            time.sleep(POLL_S)
