"""Logs: one line each on standard error, as text or as JSON."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator

import pytest

from vertebra.service.logs import configure_logs


@pytest.fixture(autouse=True)
def root_logger() -> Iterator[None]:
    """The handlers of pytest come back, whatever a test configures."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers = []  # so that configuring does not close those of pytest
    yield
    root.handlers, root.level = handlers, level


def test_text_names_level_and_service(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs("camera", "info", "text")
    logging.getLogger("vertebra.x").warning("image %d is dark", 7)
    logging.getLogger("vertebra.x").debug("not shown")
    line = capsys.readouterr().err
    assert line.endswith(" WARNING camera: image 7 is dark\n")
    assert "\x1b" not in line
    assert line.count("\n") == 1


def test_json_is_one_document_per_line(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs("camera", "debug", "json")
    try:
        json.loads("bad\nimage")
    except json.JSONDecodeError:
        logging.getLogger("vertebra.x").exception("grüezi")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    entry = json.loads(lines[0])
    assert (entry["level"], entry["service"], entry["logger"], entry["message"]) == (
        "error",
        "camera",
        "vertebra.x",
        "grüezi",
    )
    assert "JSONDecodeError" in entry["exception"]
    assert "\n" in entry["exception"]
    assert entry["time"].endswith("Z")
