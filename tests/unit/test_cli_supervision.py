"""Logs are followed through rotation; one `up` per checkout; launching becomes the program."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vertebra.cli import launch
from vertebra.cli.processes import is_held, only_one
from vertebra.cli.supervision import Follower
from vertebra.errors import ConfigError


def test_only_whole_new_lines_are_followed(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("old\n")
    follower = Follower(path)
    with path.open("a") as log:
        assert list(follower.lines()) == []
        print("one\ntw", end="", file=log, flush=True)
        assert list(follower.lines()) == ["one"]
        print("o\n", end="", file=log, flush=True)
        assert list(follower.lines()) == ["two"]
    follower.close()


def test_a_log_that_appears_later_is_read_from_its_start(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    follower = Follower(path)
    assert list(follower.lines()) == []
    path.write_text("one\n")
    assert list(follower.lines()) == ["one"]
    follower.close()


def test_nothing_is_lost_when_a_log_is_rotated(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.touch()
    follower = Follower(path)
    path.write_text("before\n")
    path.rename(tmp_path / "x.log.1")
    assert list(follower.lines()) == ["before"]
    path.write_text("after\n")
    assert list(follower.lines()) == ["after"]
    follower.close()


def test_damaged_text_is_shown_as_well_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.touch()
    follower = Follower(path)
    path.write_bytes(b"caf\xe9\n")
    assert list(follower.lines()) == ["caf\ufffd"]
    follower.close()


def test_the_second_of_two_is_refused_and_told_who_the_first_is(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    with only_one(lock):
        assert is_held(lock)
        second = only_one(lock)
        with pytest.raises(ConfigError, match=rf"runs already \(process {os.getpid()}\)"), second:
            raise AssertionError
    assert not is_held(lock)
    with only_one(lock):
        assert lock.read_text() == str(os.getpid())


def test_launching_becomes_the_program_with_its_environment(tmp_path: Path) -> None:
    table = tmp_path / "programs.json"
    show = "import os, sys; print(os.getpid(), os.environ['A'], os.environ['B'], sys.argv[1:])"
    command = [sys.executable, "-c", show, "two words", "100%", '"']
    table.write_text(json.dumps({"x": [command, {"A": "a; b % \"c\" 'd'"}]}))
    process = subprocess.Popen(
        [sys.executable, "-IS", launch.__file__, str(table), "x"],
        env={**os.environ, "A": "outer", "B": "kept"},
        stdout=subprocess.PIPE,
        text=True,
    )
    output, _ = process.communicate()
    assert output == f"{process.pid} a; b % \"c\" 'd' kept ['two words', '100%', '\"']\n"
