"""What no file of this repository may hold or do."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
FORBIDDEN_MODULES: Final = {"base64", "cloudpickle", "dill", "marshal", "pickle", "shelve"}
FORBIDDEN_CALLS: Final = {
    "eval",
    "exec",
    "os.system",
    "torch.load",
    "yaml.load",
    "yaml.unsafe_load",
}
# In pieces, so that this file does not hold them itself.
REGISTRIES: Final = [
    f"{name}.{domain}"
    for name, domain in [
        ("pypi", "org"), ("pythonhosted", "org"), ("registry.npmjs", "org"), ("yarnpkg", "com"),
        ("docker", "io/"), ("ghcr", "io"), ("quay", "io"), ("crates", "io"), ("anaconda", "org"),
        ("proxy.golang", "org"), ("deb.debian", "org"),
    ]
]  # fmt: skip
LOCK_FILES: Final = {"uv.lock", "poetry.lock", "package-lock.json", "yarn.lock", "pnpm-lock.yaml"}
MAX_BYTES: Final = 1 << 20


def git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout


def files() -> list[Path]:
    """Return the files that git knows, or will with the next commit."""
    listed = git("ls-files", "--cached", "--others", "--exclude-standard", "-z").split("\0")
    return sorted({Path(name) for name in listed if name and (ROOT / name).is_file()})


try:
    FILES: Final = files()
except (OSError, subprocess.CalledProcessError) as error:
    pytest.skip(
        f"git lists no files here ({error}); install git and clone", allow_module_level=True
    )

SOURCES: Final = [path for path in FILES if path.suffix == ".py" and "src" in path.parts]
TEXTS: Final = [path for path in FILES if b"\0" not in (ROOT / path).read_bytes()[:4096]]


def trees() -> Iterator[tuple[Path, ast.AST]]:
    for path in SOURCES:
        for node in ast.walk(ast.parse((ROOT / path).read_bytes())):
            yield path, node


def test_no_source_unpickles_or_evaluates() -> None:
    found = []
    for path, node in trees():
        match node:
            case ast.Import(names=names):
                found += [(path, each.name) for each in names if each.name in FORBIDDEN_MODULES]
            case ast.ImportFrom(module=str(module)) if module in FORBIDDEN_MODULES:
                found.append((path, module))
            case ast.Call(func=function) if ast.unparse(function) in FORBIDDEN_CALLS:
                found.append((path, ast.unparse(function)))
            case ast.keyword(arg="allow_pickle", value=ast.Constant(value=True)):
                found.append((path, "allow_pickle=True"))
            case ast.keyword(arg="shell", value=ast.Constant(value=True)):
                found.append((path, "shell=True"))
    assert found == []


def test_no_file_names_a_package_registry() -> None:
    pattern = re.compile("|".join(map(re.escape, REGISTRIES)))
    found = [
        (path, match[0])
        for path in TEXTS
        if (match := pattern.search((ROOT / path).read_text(encoding="utf-8", errors="replace")))
    ]
    assert found == []


def test_no_lock_file_with_addresses_is_kept() -> None:
    assert [path for path in FILES if path.name in LOCK_FILES] == []


def test_no_large_file_and_no_model_is_kept() -> None:
    assert [path for path in FILES if (ROOT / path).stat().st_size > MAX_BYTES] == []
    models = {".tflite", ".onnx", ".pt", ".pth", ".task", ".whl", ".npz"}
    assert [path for path in FILES if path.suffix in models] == []


@pytest.mark.parametrize(
    "path",
    [".venv/x", ".vertebra/run/x", "deploy/secrets/gateway_token", ".env", "tests/artifacts/x"],
)
def test_what_belongs_to_one_machine_is_ignored(path: str) -> None:
    assert git("check-ignore", "--no-index", path).strip() == path


def test_no_secret_is_tracked() -> None:
    secrets = [path for path in FILES if path.parts[:2] == ("deploy", "secrets")]
    assert secrets in ([], [Path("deploy/secrets/.gitkeep")])


def test_nothing_refers_to_the_workshop() -> None:
    outside = "/work" + "/shared"
    found = [
        path
        for path in TEXTS
        if outside in (ROOT / path).read_text(encoding="utf-8", errors="replace")
    ]
    assert found == []


@pytest.mark.parametrize("path", [".ci/run", "vertebra", "deploy/base-image", "deploy/engine"])
def test_scripts_may_be_run(path: str) -> None:
    assert (ROOT / path).stat().st_mode & 0o111
    assert (ROOT / path).read_text(encoding="utf-8").startswith("#!/usr/bin/env ")


def test_test_files_have_names_of_their_own() -> None:
    names = [path.name for path in FILES if path.match("tests/**/test_*.py")]
    assert sorted(set(names)) == sorted(names)
