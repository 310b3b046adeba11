"""The script `./vertebra`: what it installs when, and what it says where it cannot."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any, Final

import pytest

ROOT: Final = Path(__file__).parents[2]


class Script:
    """The script as a module, on a workspace of its own, with nothing run for real."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        loader = SourceFileLoader("vertebra_script", str(ROOT / "vertebra"))
        spec = importlib.util.spec_from_loader(loader.name, loader)
        assert spec is not None
        self.module: Any = importlib.util.module_from_spec(spec)
        loader.exec_module(self.module)
        self.commands: list[list[str]] = []
        self.root = root
        for name in ("fleet", "local", "dev", "bench"):
            self.write(f"deploy/requirements/{name}.txt", f"{name}==1\n")
        self.write("shared/pyproject.toml", "[project]\nname = 'vertebra'\n")
        self.write("services/yarp/pyproject.toml", "[project]\nname = 'vertebra-yarp'\n")
        (root / ".venv").mkdir()
        for name, value in {
            "ROOT": root,
            "VENV": root / ".venv",
            "STAMP": root / ".venv/vertebra.json",
            "REQUIREMENTS": root / "deploy/requirements",
            "environment_works": lambda: True,
            "run": lambda command, _: self.commands.append(command),
        }.items():
            monkeypatch.setattr(self.module, name, value)

    def write(self, path: str, text: str) -> None:
        (self.root / path).parent.mkdir(parents=True, exist_ok=True)
        (self.root / path).write_text(text)

    def prepare(self, command: str) -> str:
        """Return the arguments of all calls of pip that a command causes."""
        self.commands.clear()
        self.module.prepare(self.module.NEEDED.get(command, self.module.RUN))
        return " ".join(word for command in self.commands for word in command)


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Script:
    return Script(tmp_path, monkeypatch)


def test_the_first_start_installs_what_runs_the_fleet(script: Script) -> None:
    said = script.prepare("up")
    assert "install --require-hashes" in said
    assert "fleet.txt" in said
    assert "local.txt" in said
    assert "dev.txt" not in said
    assert f"--editable={script.root / 'shared'}" in said
    assert f"--editable={script.root / 'services/yarp'}" in said


def test_the_second_start_calls_nothing(script: Script) -> None:
    script.prepare("up")
    assert script.prepare("up") == ""
    assert script.prepare("doctor") == ""


def test_the_tests_need_more_once_and_take_nothing_away(script: Script) -> None:
    script.prepare("up")
    said = script.prepare("test")
    assert "dev.txt" in said
    assert "fleet.txt" not in said
    assert "--editable" not in said
    assert script.prepare("check") == script.prepare("up") == ""
    assert "bench.txt" in script.prepare("bench")


def test_what_changed_is_installed_anew(script: Script) -> None:
    script.prepare("test")
    script.write("deploy/requirements/dev.txt", "dev==2\n")
    assert script.prepare("up") == ""
    assert "dev.txt" in script.prepare("test")
    script.write("services/camera/pyproject.toml", "[project]\nname = 'vertebra-camera'\n")
    assert "services/camera" in script.prepare("up")


def test_what_failed_is_tried_again(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(command: list[str], _: str) -> None:
        raise SystemExit(" ".join(command))

    monkeypatch.setattr(script.module, "run", fail)
    for _ in range(2):
        with pytest.raises(SystemExit, match="pip"):
            script.prepare("up")


def test_an_environment_that_does_not_work_is_made_anew(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script.module, "environment_works", lambda: False)
    assert f"-m venv --clear {script.root / '.venv'}" in script.prepare("up")


def without_ensurepip(monkeypatch: pytest.MonkeyPatch, script: Script, *, root: bool) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "ensurepip" else found(name)
    )
    monkeypatch.setattr(os, "geteuid", lambda: 0 if root else 1000)
    monkeypatch.setattr(shutil, "which", lambda _: "/usr/bin/apt-get")


def test_debian_without_venv_is_mended_by_root(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without_ensurepip(monkeypatch, script, root=True)
    monkeypatch.setenv("DEBIAN_FRONTEND", "")  # put back after the test
    script.module.make_environment()
    package = f"python{sys.version_info[0]}.{sys.version_info[1]}-venv"
    assert [words[0] for words in script.commands[:2]] == ["apt-get", "apt-get"]
    assert script.commands[1][-1] == package
    assert f"running: apt-get install {package}" in capsys.readouterr().err


def test_debian_without_venv_tells_others_what_mends_it(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_ensurepip(monkeypatch, script, root=False)
    with pytest.raises(SystemExit, match=r"mend it with: sudo apt-get install python3\.\d+-venv"):
        script.module.make_environment()
    assert script.commands == []


def test_an_old_python_is_refused_politely(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 9, 2, "final", 0))
    with pytest.raises(SystemExit, match=r"3\.11 or newer is needed, .* is 3\.9\.2; install one"):
        script.module.main()


def test_the_note_of_what_is_installed_can_be_read(script: Script) -> None:
    script.prepare("up")
    noted = json.loads((script.root / ".venv/vertebra.json").read_text())
    assert set(noted) == {"fleet", "local", "our own"}
