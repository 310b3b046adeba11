"""Models are fetched through the real pip, out of a wheel that this test makes: no network."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import zipfile
from pathlib import Path

import msgspec
import pytest

from vertebra.errors import ConfigError
from vertebra_face_tracking import models
from vertebra_face_tracking.models import (
    Manifest,
    Model,
    ModelMissingError,
    Wheel,
    default_directory,
    fetch,
    load_model,
    main,
    read_manifest,
)

MEMBERS = {"nets/a.tflite": b"a" * 1000, "nets/b.tflite": b"b" * 2000}
WHEEL_NAME = "some_nets-1.0-cp311-cp311-manylinux_2_28_x86_64.whl"


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a wheel for another interpreter than most, in a folder that pip looks into."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    path = folder / WHEEL_NAME
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in MEMBERS.items():
            archive.writestr(name, content)
        archive.writestr("some_nets-1.0.dist-info/LICENSE", "do what you like")
        archive.writestr(
            "some_nets-1.0.dist-info/METADATA",
            "Metadata-Version: 2.1\nName: some-nets\nVersion: 1.0\n",
        )
        archive.writestr("some_nets-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\n")
        archive.writestr("some_nets-1.0.dist-info/RECORD", "")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    return path


def manifest_of(wheel: Path, **changes: str) -> Manifest:
    """Return the manifest for that wheel; `changes` are put into its first model."""
    source = Wheel(
        requirement="some-nets==1.0",
        python_version="3.11",
        platform="manylinux_2_28_x86_64",
        sha256=sha256(wheel.read_bytes()),
        bytes=wheel.stat().st_size,
        licence="MIT",
        licence_member="some_nets-1.0.dist-info/LICENSE",
    )
    found = {
        letter: Model(
            task="test",
            file=f"{letter}.tflite",
            wheel="some-nets-1.0",
            member=f"nets/{letter}.tflite",
            sha256=sha256(MEMBERS[f"nets/{letter}.tflite"]),
            bytes=len(MEMBERS[f"nets/{letter}.tflite"]),
            contract="",
        )
        for letter in "ab"
    }
    found["a"] = msgspec.structs.replace(found["a"], **changes)
    return Manifest(wheels={"some-nets-1.0": source}, models=found)


def test_models_are_fetched_with_their_licence_and_nothing_else(
    wheel: Path, tmp_path: Path
) -> None:
    into = tmp_path / "deep" / "models"

    paths = fetch(["a", "b"], into, manifest_of(wheel))

    assert paths == [into / "a.tflite", into / "b.tflite"]
    assert [path.read_bytes() for path in paths] == list(MEMBERS.values())
    names = sorted(path.name for path in into.iterdir())
    assert names == ["a.tflite", "b.tflite", "some-nets-1.0.LICENSE"]
    assert (into / "some-nets-1.0.LICENSE").read_text() == "do what you like"
    assert load_model("a", into, manifest_of(wheel)) == MEMBERS["nets/a.tflite"]


def test_what_is_there_is_not_fetched_again(wheel: Path, tmp_path: Path) -> None:
    manifest = manifest_of(wheel)
    fetch(["a"], tmp_path, manifest)
    wheel.unlink()  # a second look would fail

    assert fetch(["a"], tmp_path, manifest) == [tmp_path / "a.tflite"]
    with pytest.raises(ConfigError, match=r"pip could not get some-nets==1.0"):
        fetch(["a", "b"], tmp_path, manifest)


def test_a_damaged_model_is_refused_and_mended_by_fetching(wheel: Path, tmp_path: Path) -> None:
    manifest = manifest_of(wheel)
    (tmp_path / "a.tflite").write_bytes(MEMBERS["nets/a.tflite"][:-1])
    with pytest.raises(
        ModelMissingError, match=r"model damaged.*has 999 bytes.*not 1000 bytes.*fetch it"
    ):
        load_model("a", tmp_path, manifest)

    fetch(["a"], tmp_path, manifest)

    assert load_model("a", tmp_path, manifest) == MEMBERS["nets/a.tflite"]


def test_a_wheel_with_another_hash_is_refused(wheel: Path, tmp_path: Path) -> None:
    manifest = manifest_of(wheel)
    with zipfile.ZipFile(wheel, "a") as archive:
        archive.writestr("nets/evil.py", "import os")

    with pytest.raises(ConfigError, match=manifest.wheels["some-nets-1.0"].sha256):
        fetch(["a"], tmp_path / "into", manifest)
    assert list((tmp_path / "into").iterdir()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sha256": "0" * 64}, "not 0000"),
        ({"member": "nets/c.tflite"}, "no member 'nets/c.tflite'"),
    ],
)
def test_a_member_that_is_not_what_the_manifest_says_is_never_written(
    wheel: Path, tmp_path: Path, change: dict[str, str], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        fetch(["a"], tmp_path / "into", manifest_of(wheel, **change))

    assert not (tmp_path / "into" / "a.tflite").exists()


def test_a_failed_write_leaves_no_part_behind(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_space(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", no_space)
    with pytest.raises(ConfigError, match="No space left on device; choose another directory"):
        fetch(["a"], tmp_path / "into", manifest_of(wheel))
    assert list((tmp_path / "into").iterdir()) == []


def test_a_directory_that_cannot_be_made_is_a_clear_error(wheel: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")

    with pytest.raises(ConfigError, match=r"cannot be written into .*file/models"):
        fetch(["a"], blocked / "models", manifest_of(wheel))


def test_pip_is_not_waited_for_for_ever(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "FETCH_TIMEOUT_S", 0.01)

    with pytest.raises(ConfigError, match=r"pip did not get some-nets==1.0 in 0.01 s"):
        fetch(["a"], tmp_path, manifest_of(wheel))


def test_a_python_without_pip_is_a_clear_error(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "find_spec", lambda name: None)

    with pytest.raises(ConfigError, match=r"has no pip to fetch some-nets==1.0 with; run this"):
        fetch(["a"], tmp_path, manifest_of(wheel))


def test_an_unknown_name_is_an_error_that_lists_the_known_ones(wheel: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no model 'c'; it has: a, b"):
        fetch(["c"], tmp_path, manifest_of(wheel))


def test_the_directory_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_MODELS", "/somewhere")
    assert default_directory() == Path("/somewhere")
    monkeypatch.setenv("VERTEBRA_MODELS", "")
    monkeypatch.setenv("HOME", "/home/someone")
    assert default_directory() == Path("/home/someone/.cache/vertebra/models")


def test_the_packaged_manifest_is_sound() -> None:
    manifest = read_manifest()

    assert manifest.models
    for model in manifest.models.values():
        assert len(model.sha256) == 64
        assert model.wheel in manifest.wheels
        assert Path(model.file).name == model.file
    for source in manifest.wheels.values():
        assert len(source.sha256) == 64
        assert "==" in source.requirement
    assert len({model.file for model in manifest.models.values()}) == len(manifest.models)


def test_deploy_shows_the_manifest_that_the_service_reads() -> None:
    shown = Path(__file__).parents[2] / "deploy" / "models" / "manifest.toml"

    assert msgspec.toml.decode(shown.read_bytes(), type=Manifest) == read_manifest()


def test_the_command_line_lists_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0

    printed = capsys.readouterr().out
    for name, model in read_manifest().models.items():
        assert name in printed
        assert model.sha256 in printed


def test_the_command_line_fails_when_a_model_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", "--into", str(tmp_path)]) == 1

    assert "model missing" in capsys.readouterr().err


def test_the_command_of_the_remedy_is_a_command(tmp_path: Path) -> None:
    """What an error tells people to type must at least be understood."""
    with pytest.raises(ConfigError) as caught:
        load_model("blazeface-full-range", tmp_path)
    _, _, command = str(caught.value).partition("fetch it with: python ")

    arguments = ["verify" if word == "fetch" else word for word in command.split()]
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=30, check=False
    )

    assert done.returncode == 1
    assert "model missing" in done.stderr
