"""Logs: one line each on standard error, as text or as JSON."""

from __future__ import annotations

import json
import logging
import sys
import time
from typing import Final

_COLORS: Final = {"WARNING": "\x1b[33m", "ERROR": "\x1b[31m", "CRITICAL": "\x1b[31m"}


class _TextFormatter(logging.Formatter):
    def __init__(self, service: str, *, colored: bool) -> None:
        super().__init__(
            f"%(asctime)s.%(msecs)03d %(levelname)-7s {service}: %(message)s", "%H:%M:%S"
        )
        self._colored = colored

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        color = _COLORS.get(record.levelname) if self._colored else None
        return f"{color}{text}\x1b[0m" if color else text


class _JsonFormatter(logging.Formatter):
    def __init__(self, service: str) -> None:
        super().__init__()
        self._service = service

    def format(self, record: logging.LogRecord) -> str:
        milliseconds = f"{record.msecs:03.0f}"
        entry = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
            + f".{milliseconds}Z",
            "level": record.levelname.lower(),
            "service": self._service,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


def configure_logs(service: str, level: str, log_format: str) -> None:
    """Send all logs of this process to standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        _JsonFormatter(service)
        if log_format == "json"
        else _TextFormatter(service, colored=sys.stderr.isatty())
    )
    logging.basicConfig(handlers=[handler], level=level.upper(), force=True)
