"""Every third-party dependency is pinned with hashes, once, and without any index address."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Final

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT: Final = Path(__file__).parents[2]
SETS: Final = sorted(ROOT.glob("deploy/requirements/*.txt"))
PROJECTS: Final = [
    ROOT / "shared/pyproject.toml",
    *sorted(ROOT.glob("plugins/*/pyproject.toml")),
    *sorted(ROOT.glob("services/*/pyproject.toml")),
]
REMEDY: Final = "run deploy/requirements/compile.py"


def pins(file: Path) -> dict[str, str]:
    """Return name and version of all pins in one set."""
    text = file.read_text("utf-8")
    return dict(re.findall(r"^([a-z0-9-]+)==(\S+)", text, flags=re.MULTILINE))


@pytest.mark.parametrize("file", SETS, ids=lambda file: file.stem)
def test_pins_have_hashes_and_nothing_else(file: Path) -> None:
    pin = re.compile(r"[a-z0-9-]+==[^\s;]+( ; .+)? \\\n(    --hash=sha256:[0-9a-f]{64}( \\)?\n)+")

    rest = pin.sub("", file.read_text("utf-8"))

    assert rest.startswith("# Made by deploy/requirements/compile.py")
    assert rest.count("\n") == 1


def test_a_package_has_one_version_everywhere() -> None:
    versions: dict[str, set[str]] = {}
    for file in SETS:
        for name, version in pins(file).items():
            versions.setdefault(name, set()).add(version)

    assert {name: found for name, found in versions.items() if len(found) > 1} == {}, REMEDY


@pytest.mark.parametrize("file", PROJECTS, ids=lambda file: file.parent.name)
def test_what_a_distribution_needs_is_pinned(file: Path) -> None:
    read = (tomllib.loads(each.read_text("utf-8"))["project"] for each in PROJECTS)
    ours = {project["name"]: project.get("optional-dependencies", {}) for project in read}
    project = tomllib.loads(file.read_text("utf-8"))["project"]
    own_set = ROOT / f"deploy/requirements/{file.parent.name}.txt"
    sets = [ROOT / "deploy/requirements/fleet.txt"]
    if file.parents[1].name == "services" and not file.parent.name.startswith("_"):
        sets.append(own_set)

    needed = [*map(Requirement, project["dependencies"])]
    for requirement in needed:
        if requirement.name in ours:
            extras = ours[requirement.name]
            needed += (Requirement(one) for extra in requirement.extras for one in extras[extra])
            continue
        for pinned in map(pins, sets):
            version = pinned.get(canonicalize_name(requirement.name), "none")
            assert version in requirement.specifier, f"{requirement} but {version}; {REMEDY}"
