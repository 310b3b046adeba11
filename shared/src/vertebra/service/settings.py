"""Settings of a service: from the environment and a YAML file, strict, printable."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict, SettingsError

from vertebra.bus import DEFAULT_ROUTER
from vertebra.errors import ConfigError


class ServiceSettings(BaseSettings):
    """What every service can be told; a service adds its own fields.

    A subclass sets `env_prefix` (`VERTEBRA_YARP_`); its own field `name_server` is then read from
    `VERTEBRA_YARP_NAME_SERVER`, or from `name_server:` in the YAML file that `VERTEBRA_YARP_FILE`
    names. The environment wins over the file. An empty variable is an unset one.
    """

    model_config = SettingsConfigDict(
        frozen=True, extra="forbid", env_ignore_empty=True, populate_by_name=True
    )

    router: str = Field(
        DEFAULT_ROUTER,
        validation_alias="VERTEBRA_ROUTER",
        description="Zenoh locator of the router.",
    )
    shared_memory: bool = Field(
        default=True,
        validation_alias="VERTEBRA_SHARED_MEMORY",
        description="Send large payloads through shared memory where that works.",
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info",
        validation_alias="VERTEBRA_LOG_LEVEL",
        description="Least severe level that is logged.",
    )
    log_format: Literal["text", "json"] = Field(
        "text", validation_alias="VERTEBRA_LOG_FORMAT", description="One line of text or JSON."
    )
    instance: str = Field(
        "1",
        validation_alias="VERTEBRA_INSTANCE",
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="Tells two services of one kind apart.",
    )

    def check(self) -> None:
        """Look at what the settings name, such as files; called before the service joins the bus.

        Raises:
            ConfigError: Something of it is wrong.
        """


S = TypeVar("S", bound=ServiceSettings)


def load_settings(settings_type: type[S]) -> S:
    """Return the settings in force: the environment, then the file, then the defaults.

    Raises:
        ConfigError: A value is wrong, or a variable or key is unknown; all faults are listed.
    """
    prefix = str(settings_type.model_config.get("env_prefix", ""))
    file_variable = f"{prefix}FILE"
    own = {
        name: f"{prefix}{name.upper()}"
        for name, field in settings_type.model_fields.items()
        if field.validation_alias is None
    }
    problems = [
        _unknown(variable, [*own.values(), file_variable])
        for variable in os.environ
        if prefix and variable.startswith(prefix)
        if variable not in own.values() and variable != file_variable
    ]
    from_file = _read_file(os.environ.get(file_variable, ""))
    problems += [_unknown(key, list(own)) for key in from_file if key not in own]
    if problems:
        raise ConfigError("\n".join(problems))
    # The environment wins: hand over from the file only what no variable sets.
    values = {key: value for key, value in from_file.items() if not os.environ.get(own[key])}
    try:
        return settings_type(**values)
    except SettingsError as error:  # says which field, not what is wrong
        raise ConfigError(_not_json(str(error), own)) from error
    except ValidationError as error:
        secrets = {
            name
            for name, field in settings_type.model_fields.items()
            if field.annotation is SecretStr
        }
        problems = [_describe(fault, own, secrets) for fault in error.errors()]
        raise ConfigError("\n".join(problems)) from error


def _describe(fault: Any, own: dict[str, str], secrets: set[str]) -> str:
    if not fault["loc"]:
        return str(fault["msg"])  # the input is all settings together, secrets included
    field, *inside = map(str, fault["loc"])
    place = ".".join([own.get(field, field), *inside])
    value = "(secret)" if field in secrets else repr(fault["input"])
    return f"{place} = {value}: {fault['msg']}"


def _not_json(text: str, own: dict[str, str]) -> str:
    for name, variable in own.items():
        if f'"{name}"' in text:
            return f'{variable} = {os.environ[variable]!r}: lists are JSON, such as ["a", "b"]'
    return text


def describe(settings: ServiceSettings) -> str:
    """Return the effective settings as YAML; secrets are masked."""
    return yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=True)


def _read_file(path: str) -> dict[str, Any]:
    if not path:
        return {}
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"the settings file {path!r} cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"the settings file {path!r} is no YAML: {error}") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"the settings file {path!r} is a {type(content).__name__}, not a map")
    return content


def _unknown(name: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"
    return f"{name} is not a setting; {hint}"
