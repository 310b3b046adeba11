"""The heartbeat file and the health check that reads it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vertebra import heartbeat


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))
    return tmp_path


def run_check(*services: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "vertebra.heartbeat", *services],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stderr


def test_a_service_that_beats_is_well() -> None:
    heartbeat.beat("camera")
    assert heartbeat.check(heartbeat.heartbeat_path("camera")) == ""
    assert run_check("camera") == (0, "")
    assert run_check() == (0, "")


def test_a_problem_is_what_the_check_says() -> None:
    heartbeat.beat("camera")
    heartbeat.beat("yarp", "the name server is away")
    assert run_check() == (1, "the name server is away\n")
    assert run_check("camera") == (0, "")


def test_a_service_that_stopped_beating_hangs() -> None:
    heartbeat.beat("camera")
    path = heartbeat.heartbeat_path("camera")
    past_s = time.time() - 60
    os.utime(path, (past_s, past_s))
    assert "60 s old: the service hangs" in heartbeat.check(path)
    assert heartbeat.check(path, max_age_s=120) == ""


def test_a_service_that_never_beat_has_not_started(folder: Path) -> None:
    status, text = run_check("camera")
    assert (status, f"no heartbeat at {folder}/vertebra-camera.heartbeat" in text) == (1, True)
    status, text = run_check()
    assert (status, "no service has started" in text) == (1, True)


def test_a_reader_never_sees_half_a_heartbeat(folder: Path) -> None:
    heartbeat.beat("camera", "x" * 100_000)
    heartbeat.beat("camera")
    assert [path.name for path in folder.iterdir()] == ["vertebra-camera.heartbeat"]


def test_without_a_folder_it_is_the_temporary_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VERTEBRA_HEARTBEAT_DIR")
    assert heartbeat.heartbeat_path("camera").parent == Path("/tmp")


def test_the_check_imports_little() -> None:
    code = "import sys, vertebra.heartbeat; print([m for m in sys.modules if 'zenoh' in m])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
