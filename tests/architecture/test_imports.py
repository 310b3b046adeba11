"""Who may import what: contracts between packages, and which files may know which library."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, Final

import pytest

ROOT: Final = Path(__file__).parents[2]
SOURCES: Final = sorted(
    path.relative_to(ROOT)
    for pattern in ("shared/src/**/*.py", "plugins/*/src/**/*.py", "services/*/src/**/*.py")
    for path in ROOT.glob(pattern)
)
CONFIGURATION: Final[dict[str, Any]] = tomllib.loads(
    (ROOT / "pyproject.toml").read_text(encoding="utf-8")
)["tool"]["importlinter"]

WHERE: Final = {
    # the backbone
    "zenoh": ["shared/src/vertebra/bus/*", "shared/src/vertebra/ros2/rmw_zenoh/*"],
    # models
    "ai_edge_litert": ["services/*/model.py"],
    "onnxruntime": ["services/*/model.py"],
    "torch": [],
    "tensorflow": [],
    # middleware of others
    **{
        library: ["services/*/driver*.py"]
        for library in ("aiomqtt", "paho", "rospy", "yarp", "zmq")
    },
    **{
        library: ["shared/src/vertebra/ros2/rclpy/*.py"]
        for library in ("rclpy", "rosidl_generator_py", "rosidl_runtime_py")
    },
    "cyclonedds": ["shared/src/vertebra/ros2/dds/*.py"],
    "rosbags": [
        "shared/src/vertebra/ros2/definitions.py",
        "shared/src/vertebra/ros2/interface_files.py",
    ],
    # pictures and numbers
    "cv2": ["services/camera/*/driver_opencv.py", "services/face_tracking/*"],
    "PIL": ["plugins/pillow/*", "services/camera/*", "services/gateway/*", "services/simulator/*"],
    "numpy": ["plugins/numpy/*", "services/*", "shared/src/vertebra/ros2/mapping/*"],
    # the web
    "fastapi": ["services/gateway/*"],
    "starlette": ["services/gateway/*"],
    "uvicorn": ["services/gateway/*"],
    "websockets": ["services/gateway/*"],
    # tests
    "hypothesis": ["shared/src/vertebra/testing/*"],
    "pytest": ["shared/src/vertebra/testing/*"],
}
"""Files that may import a library; what is not listed here any file may."""

PURE: Final = {
    "shared/src/vertebra/codec/*.py", "shared/src/vertebra/goals.py", "shared/src/vertebra/keys.py",
    "shared/src/vertebra/messages/*.py",
    "shared/src/vertebra/ros2/actions.py",
    "shared/src/vertebra/ros2/cdr/*.py", "shared/src/vertebra/ros2/definitions.py",
    "shared/src/vertebra/ros2/graph.py", "shared/src/vertebra/ros2/humans.py",
    "shared/src/vertebra/ros2/interface_files.py", "shared/src/vertebra/ros2/mapping/*.py",
    "shared/src/vertebra/ros2/names.py", "shared/src/vertebra/ros2/qos.py",
    "shared/src/vertebra/ros2/rmw_zenoh/wire.py",
    "shared/src/vertebra/yarp/protocol/*.py", "shared/src/vertebra/yarp/objects/*.py",
    "shared/src/vertebra/yarp/ports/incoming.py",
    "plugins/*.py",
    "services/*/board.py", "services/*/body.py", "services/*/geometry.py",
    "services/simulator/*/base.py", "services/simulator/*/floorplan.py",
    "services/simulator/*/navigator.py", "services/simulator/*/records.py",
    "services/*/mapping/*.py", "services/*/pipeline.py", "services/*/scene.py",
    "services/*/tracker.py", "services/gateway/*/commands.py",
    "services/gateway/*/ws_protocol.py",
}  # fmt: skip
"""Modules that decide without I/O, so that property tests can reach everything in them."""
IMPURE: Final = frozenset(
    {"asyncio", "concurrent", "multiprocessing", "select", "selectors", "socket", "subprocess",
     "threading", "zenoh"}
)  # fmt: skip


def imports(path: Path) -> Iterator[str]:
    """Yield the top-level package of each import, wherever in the file it is."""
    for node in ast.walk(ast.parse((ROOT / path).read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


def test_the_contracts_between_packages_are_kept() -> None:
    command = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_package_is_under_contract() -> None:
    remedy = "list the package in all contracts of [tool.importlinter] in pyproject.toml"
    packages = {path.parts[path.parts.index("src") + 1] for path in SOURCES}
    siblings, *_, zenoh = CONFIGURATION["contracts"]
    others = packages - {"vertebra"}
    parts = {
        f"vertebra.{path.with_suffix('').parts[3]}"
        for path in SOURCES
        if path.is_relative_to("shared/src/vertebra") and path.parts[3] != "__init__.py"
    }
    assert set(CONFIGURATION["root_packages"]) == packages, remedy
    assert {name.strip() for name in siblings["layers"][0].split("|")} == others, remedy
    assert set(zenoh["source_modules"]) == others | parts - {"vertebra.bus"}, remedy


@pytest.mark.parametrize("library", WHERE)
def test_a_library_is_known_only_where_it_belongs(library: str) -> None:
    strangers = [
        str(path)
        for path in SOURCES
        if library in imports(path)
        and not any(fnmatch(str(path), pattern) for pattern in WHERE[library])
    ]
    assert strangers == []


@pytest.mark.parametrize("pattern", sorted(PURE))
def test_modules_that_decide_do_no_io(pattern: str) -> None:
    pure = [path for path in SOURCES if fnmatch(str(path), pattern)]
    assert pure, "no such module any more; take the pattern off the list"
    for path in pure:
        assert IMPURE.isdisjoint(imports(path)), path


def test_relative_imports_are_not_used() -> None:
    for path in SOURCES:
        for node in ast.walk(ast.parse((ROOT / path).read_bytes())):
            assert not (isinstance(node, ast.ImportFrom) and node.level), path
