"""Every robot that is shipped: its profile, its YARP routes, and that they fit each other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pytest

from vertebra.service.routes import read_routes
from vertebra_gateway.profile import Part, Profile, load_profiles
from vertebra_yarp.routes import (
    KINDS,
    AnyRoute,
    ControlBoard,
    FaceRoute,
    GazeRoute,
    SpeakerRoute,
    Stream,
    YarpRoute,
)

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
SHIPPED: Final = {
    "simulated": ("robots/vizzy.yaml", "yarp/routes.yaml"),
    "icub": ("robots/lab/icub.yaml", "yarp/icub.yaml"),
    "r1": ("robots/lab/r1.yaml", "yarp/r1.yaml"),
    "vizzy": ("robots/lab/vizzy.yaml", "yarp/vizzy.yaml"),
}
ROUTES_OF: Final[dict[str, type[YarpRoute]]] = {
    "control_board": ControlBoard,
    "gaze": GazeRoute,
    "face": FaceRoute,
    "speaker": SpeakerRoute,
}
Robot = tuple[Profile, tuple[AnyRoute, ...]]


@pytest.fixture(params=SHIPPED)
def robot(request: pytest.FixtureRequest) -> Robot:
    profile, routes = SHIPPED[request.param]
    (loaded,) = load_profiles(DEPLOY / profile)
    return loaded, read_routes(DEPLOY / routes, KINDS)


def test_every_file_that_is_shipped_is_tested_here() -> None:
    tested = {DEPLOY / path for pair in SHIPPED.values() for path in pair}
    assert {*DEPLOY.glob("robots/**/*.yaml"), *DEPLOY.glob("yarp/*.yaml")} == tested


def test_every_part_has_its_route_and_every_route_its_part(robot: Robot) -> None:
    profile, routes = robot
    for kind, route_kind in ROUTES_OF.items():
        parts = {part.key for part in profile.parts if part.kind == kind}
        assert parts == {route.key for route in routes if isinstance(route, route_kind)}, kind


def test_what_is_read_of_a_yarp_robot_is_carried(robot: Robot) -> None:
    profile, routes = robot
    carried = {route.key for route in routes if isinstance(route, Stream)}
    carried |= {f"{route.key}/state" for route in routes if isinstance(route, ControlBoard)}
    ros = tuple(f"{part.key}/" for part in profile.parts if part.kind in {"base", "action"})
    for resource in profile.resources:
        if resource.kind != "call" and not resource.key.endswith("/faces"):
            assert resource.key in carried or resource.key.startswith(ros)


def test_a_robot_fits_on_a_page(robot: Robot) -> None:
    profile, _ = robot
    assert len(profile.parts) >= 4
    for profile_path, routes_path in SHIPPED.values():
        for path in (profile_path, routes_path):
            assert len((DEPLOY / path).read_text().splitlines()) <= 60


def test_parts_offer_what_they_are_asked_for(robot: Robot) -> None:
    profile, _ = robot
    head = next(part for part in profile.parts if part.path == "head")
    assert head == Part(kind="control_board", path="head", key=head.key)
    for path in ("joints", "limits", "move", "move_by", "velocity", "direct", "modes", "stop"):
        resource = profile.resource(f"head/{path}")
        assert resource is not None
        assert resource.limits is None or resource.limits.source == "head/limits"
        assert resource.key == f"{head.key}/{'state' if path == 'joints' else path}"


def test_settings_in_the_readme_name_files_that_are_shipped() -> None:
    text = (DEPLOY / "README.md").read_text(encoding="utf-8")
    named = re.findall(r"=/etc/vertebra/(\S+\.yaml)", text)
    assert len(named) == 2
    for path in named:
        assert (DEPLOY / path).is_file(), path
    mounted = (DEPLOY.parent / "compose.yaml").read_text(encoding="utf-8")
    assert "./deploy/yarp:/etc/vertebra/yarp:ro" in mounted
    assert "./deploy/robots:/etc/vertebra/robots:ro" in mounted
