"""What a machine's YARP configuration says: `yarp.conf`, namespaces, environment variables.

Nothing is read before it is asked for, and the environment is always an argument.
"""

from __future__ import annotations

import configparser
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from vertebra.errors import ConfigError
from vertebra.yarp.protocol.text import from_text

ROOT: Final = "/root"
DEFAULT_TCP_PORT: Final = 10000


@dataclass(frozen=True, slots=True)
class ServerAddress:
    """Where a name server should be, and the namespace it serves (the name of its own port)."""

    namespace: str
    host: str
    tcp_port: int


def configured_name_servers(env: Mapping[str, str]) -> list[ServerAddress]:
    """Return the name servers of all namespaces that have a file; the first one gets new names.

    Raises:
        ConfigError: A file cannot be read as `HOST PORT [yarp]` or an ini section.
    """
    folder = _config_folder(env)
    found = []
    for namespace in namespaces(env):
        path = folder / _config_file(namespace)
        text = _read(path)
        if not text.strip():
            continue
        try:
            found.append(ServerAddress(namespace, *_parse_config(text)))
        except (ValueError, KeyError, configparser.Error) as error:
            raise ConfigError(
                f"{path} does not say `HOST PORT yarp`, such as `127.0.0.1 10000 yarp`: {error}"
            ) from error
    return found


def namespaces(env: Mapping[str, str]) -> list[str]:
    """Return the namespaces in use, from `YARP_NAMESPACE` or the file beside `yarp.conf`."""
    text = env.get("YARP_NAMESPACE", "") or _read(_config_folder(env) / "yarp_namespace.conf")
    return [word for word in from_text(text) if isinstance(word, str)] or [ROOT]


def config_path(env: Mapping[str, str]) -> Path:
    """Return the file that says where the name server of the first namespace is."""
    return _config_folder(env) / _config_file(namespaces(env)[0])


def default_tcp_port(env: Mapping[str, str]) -> int:
    """Return the port number of a name server, TCP and for discovery, that nobody chose."""
    text = env.get("YARP_PORT_RANGE", "")
    if not text:
        return DEFAULT_TCP_PORT
    if not text.isdecimal() or not 0 < int(text) < 65536:
        raise ConfigError(f"YARP_PORT_RANGE is {text!r}; it must be a TCP port, such as 10000")
    return int(text)


def opened_as(name: str, env: Mapping[str, str]) -> tuple[str, int]:
    """Return the name and TCP port (0: any) with which to open what a program calls `name`.

    Users steer programs that they cannot change by `YARP_PORTNUMBER_<name>`, `YARP_RENAME_<name>`
    (the name with `_` for all but letters and digits) and `YARP_PORT_PREFIX`, in this order.
    """
    safe = _safe(name)
    variable = f"YARP_PORTNUMBER{safe}"
    text = env.get(variable, "") or "0"
    if not text.isdecimal() or int(text) > 65535:
        raise ConfigError(f"{variable} is {text!r}; it must be a TCP port")
    name = env.get(f"YARP_RENAME{safe}") or name
    if name.startswith("/"):
        name = env.get("YARP_PORT_PREFIX", "") + name
    return name, int(text)


def _safe(name: str) -> str:
    return re.sub("[^0-9A-Za-z]", "_", name)


def _config_folder(env: Mapping[str, str]) -> Path:
    if env.get("YARP_CONFIG_HOME"):
        return Path(env["YARP_CONFIG_HOME"])
    if env.get("XDG_CONFIG_HOME"):
        return Path(env["XDG_CONFIG_HOME"]) / "yarp"
    return Path(env.get("HOME", "/")) / ".config" / "yarp"


def _config_file(namespace: str) -> str:
    return "yarp.conf" if namespace == ROOT else f"{_safe(namespace)}.conf"


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error


def _parse_config(text: str) -> tuple[str, int]:
    if text.lstrip().startswith("["):
        sections = configparser.ConfigParser(interpolation=None)
        sections.read_string(text)
        section = sections[sections.sections()[0]]
        words = [section["host"], section["port"], section.get("mode", "yarp")]
    else:
        words = text.replace('"', " ").split()
    host, tcp_port, mode = [*words, "yarp"][:3]
    if mode not in ("yarp", "//"):
        raise ValueError(f"mode {mode!r} is not a YARP name server")
    if not 0 < int(tcp_port) < 65536:
        raise ValueError(f"{tcp_port} is not a TCP port")
    return host, int(tcp_port)
