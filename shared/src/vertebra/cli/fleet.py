"""The fleet as compose.yaml describes it, read for processes on this machine."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from vertebra.errors import ConfigError

_VARIABLE: Final = re.compile(
    r"\$(?:\$|\{(?P<name>[A-Za-z_]\w*)(?:(?P<operator>:-|:\?)(?P<text>[^}]*))?\}|(?P<bad>))"
)


@dataclass(frozen=True, slots=True)
class Program:
    """A service of the fleet as a local process.

    Attributes:
        name: The service's name in compose.yaml.
        command: Program and arguments.
        environment: What compose.yaml sets for it.
    """

    name: str
    command: tuple[str, ...]
    environment: dict[str, str]


def read_variables(text: str) -> dict[str, str]:
    """Return the variables in the text of an env file: `NAME=value` lines and comments."""
    variables = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, equals, value = line.partition("=")
        if not equals or not name.isidentifier():
            raise ConfigError(f"line {number}, {line!r}, is not NAME=value")
        variables[name] = value
    return variables


def interpolate(text: str, variables: Mapping[str, str]) -> str:
    """Return `text` with `${NAME}`, `${NAME:-default}`, `${NAME:?message}` and `$$` resolved.

    Raises:
        ConfigError: A variable that must be set is not, or a form that compose knows is used
            which this function does not.
    """

    def resolve(match: re.Match[str]) -> str:
        if match["bad"] is not None:
            raise ConfigError(
                f"{text!r}: only ${{NAME}}, ${{NAME:-default}}, ${{NAME:?message}} and $$ "
                "are understood here"
            )
        if match["name"] is None:
            return "$"
        value = variables.get(match["name"], "")
        if not value and match["operator"] == ":?":
            raise ConfigError(f"{match['name']} is not set: {match['text']}")
        return value or match["text"] or ""

    return _VARIABLE.sub(resolve, text)


def mentioned_variables(text: str) -> frozenset[str]:
    """Return the names of all variables that a compose file asks for."""
    return frozenset(match["name"] for match in _VARIABLE.finditer(text) if match["name"])


def read_fleet(
    text: str,
    variables: Mapping[str, str],
    *,
    profiles: Collection[str] = (),
    services: Collection[str] = (),
) -> list[Program]:
    """Return the programs of a compose file.

    Args:
        text: The compose file.
        variables: What it interpolates.
        profiles: Profiles that are switched on.
        services: The services that are wanted; empty for all that the profiles leave on.

    Raises:
        ConfigError: A profile or service is unknown, or the file says what a local process cannot
            have.
    """
    described: dict[str, dict[str, Any]] = yaml.safe_load(text)["services"]
    _check_known(
        "profile", profiles, {name for entry in described.values() for name in _profiles(entry)}
    )
    _check_known("service", services, described)
    return [
        Program(
            name,
            tuple(_words(name, entry, "command", variables)),
            dict(_environment(name, entry, variables)),
        )
        for name, entry in described.items()
        if (name in services if services else _is_on(entry, profiles))
    ]


def _profiles(entry: Mapping[str, Any]) -> list[str]:
    return list(entry.get("profiles", []))


def _is_on(entry: Mapping[str, Any], profiles: Collection[str]) -> bool:
    wanted = _profiles(entry)
    return not wanted or any(profile in profiles for profile in wanted)


def _check_known(what: str, asked: Collection[str], known: Collection[str]) -> None:
    for name in asked:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"
            raise ConfigError(f"compose.yaml has no {what} {name!r}; {hint}")


def _words(
    service: str, entry: Mapping[str, Any], field: str, variables: Mapping[str, str]
) -> Iterator[str]:
    value = entry.get(field)
    if not isinstance(value, list):
        raise ConfigError(f"compose.yaml: {field} of {service} is a list of words, not {value!r}")
    for word in value:
        yield interpolate(str(word), variables)


def _environment(
    service: str, entry: Mapping[str, Any], variables: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    value = entry.get("environment", {})
    if not isinstance(value, dict):
        raise ConfigError(f"compose.yaml: environment of {service} is a map, not {value!r}")
    for name, given in value.items():
        if given is not None:
            yield name, interpolate(str(given), variables)
        elif name in variables:  # a name without a value is handed through
            yield name, variables[name]


def active_variables(root: Path, environment: Mapping[str, str]) -> dict[str, str]:
    """Return what compose.yaml interpolates here: deploy/local.env, then the environment."""
    file = root / "deploy" / "local.env"
    return read_variables(file.read_text(encoding="utf-8")) | {
        name: value for name, value in environment.items() if value
    }
