"""Every folder has its shape, every setting its line in a README, every public name its place."""

from __future__ import annotations

import ast
import importlib
import re
import tomllib
from pathlib import Path
from typing import Any, Final

import pytest
from pydantic.fields import FieldInfo

from vertebra.service import ServiceSettings

ROOT: Final = Path(__file__).parents[2]
SERVICES: Final = sorted(path.parent.name for path in ROOT.glob("services/*/pyproject.toml"))
PLUGINS: Final = sorted(path.parent.name for path in ROOT.glob("plugins/*/pyproject.toml"))
HEADINGS: Final = [
    "What it carries", "Names", "Types", "Delivery", "Settings", "Limits", "Try it",
]  # fmt: skip
every_service = pytest.mark.parametrize("name", SERVICES)
every_distribution = pytest.mark.parametrize(
    "folder",
    [
        "shared",
        *(f"plugins/{name}" for name in PLUGINS),
        *(f"services/{name}" for name in SERVICES),
    ],
)


def package(service: str) -> str:
    return f"vertebra_{service.removeprefix('_')}"


def settings_of(service: str) -> type[ServiceSettings]:
    """Return the settings class of a service."""
    module = importlib.import_module(f"{package(service)}.settings")
    (found,) = (
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, ServiceSettings)
        and value.__module__ == module.__name__
    )
    return found


def own_settings(service: str) -> dict[str, FieldInfo]:
    """Return the settings that a service adds to those that all have, by variable."""
    cls = settings_of(service)
    prefix = cls.model_config.get("env_prefix", "")
    return {
        str(field.validation_alias or f"{prefix}{name.upper()}"): field
        for name, field in cls.model_fields.items()
        if name not in ServiceSettings.model_fields
    }


@every_service
def test_a_service_has_the_shape_of_all_services(name: str) -> None:
    source = ROOT / "services" / name / "src" / package(name)
    for file in ("__init__.py", "__main__.py", "settings.py", "py.typed"):
        assert (source / file).is_file(), file
    assert (source / "adapter.py").is_file() or (source / "pipeline.py").is_file()
    assert [path.name for path in source.parent.iterdir() if path.suffix != ".egg-info"] == [
        source.name
    ]
    main = (source / "__main__.py").read_text(encoding="utf-8")
    assert f'sys.exit(main("{name.removeprefix("_")}", ' in main


@every_service
def test_a_readme_answers_the_same_questions(name: str) -> None:
    text = (ROOT / "services" / name / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)$", text, flags=re.MULTILINE) == HEADINGS
    assert text.startswith("# ")
    sections = re.split(r"^## .+$", text, flags=re.MULTILINE)
    assert all(section.strip() for section in sections)


@every_service
def test_every_setting_is_in_the_readme_and_no_other(name: str) -> None:
    text = (ROOT / "services" / name / "README.md").read_text(encoding="utf-8")
    table = text.partition("## Settings")[2].partition("\n## ")[0]
    listed = re.findall(r"^\| `(VERTEBRA_\w+)`", table, flags=re.MULTILINE)
    assert sorted(listed) == sorted(own_settings(name))


@every_service
def test_every_setting_says_what_it_is(name: str) -> None:
    prefix = settings_of(name).model_config.get("env_prefix")
    assert prefix == f"VERTEBRA_{name.removeprefix('_').upper()}_"
    for variable, field in own_settings(name).items():
        assert field.description, variable
        assert field.description.endswith("."), variable


@every_distribution
def test_a_distribution_is_described_alike(folder: str) -> None:
    project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text("utf-8"))["project"]
    name = Path(folder).name.removeprefix("_").replace("_", "-")
    assert project["name"] == ("vertebra" if folder == "shared" else f"vertebra-{name}")
    assert (project["requires-python"], project["license"]) == (">=3.11", "Apache-2.0")
    assert project["description"]


def public_packages() -> list[str]:
    """Return the packages that users import from."""
    files = [*ROOT.glob("shared/src/**/__init__.py"), *ROOT.glob("plugins/*/src/*/__init__.py")]
    return sorted(
        ".".join(path.parent.parts[path.parent.parts.index("src") + 1 :])
        for path in files
        if "from vertebra" in path.read_text(encoding="utf-8")
    )


@pytest.mark.parametrize("name", public_packages())
def test_public_names_are_complete(name: str) -> None:
    """That they are sorted is ruff's to say."""
    module: Any = importlib.import_module(name)
    imported = {
        alias.asname or alias.name
        for node in ast.parse(Path(module.__file__).read_bytes()).body
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
    }
    assert imported <= set(module.__all__)
    assert all(hasattr(module, each) for each in module.__all__)
