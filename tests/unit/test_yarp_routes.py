"""Routes are read strictly, and errors point at the line."""

from __future__ import annotations

from pathlib import Path

import pytest

from vertebra.errors import ConfigError
from vertebra.service.routes import parse_routes, read_routes
from vertebra.yarp import Dialect
from vertebra_yarp.adapter import dialects
from vertebra_yarp.routes import KINDS, Call, ControlBoard, Stream
from vertebra_yarp.settings import YarpSettings

SHIPPED = Path(__file__).parents[2] / "deploy" / "yarp" / "routes.yaml"


def test_shipped_routes_are_valid() -> None:
    routes = read_routes(SHIPPED, KINDS)
    assert ControlBoard(yarp="/vizzy/head", key="vizzy/head") in routes
    assert Call(yarp="/vizzy/head/rpc:i", key="vizzy/head/rpc") in routes
    assert {route.type for route in routes if isinstance(route, Stream)} == {"Image", "Imu", "auto"}


@pytest.mark.parametrize("text", ["", "# nothing\n", "streams:\n", "streams: []\ncalls:\n"])
def test_no_routes_are_routes_too(text: str) -> None:
    assert parse_routes(text, "x", KINDS) == ()


def test_defaults() -> None:
    routes = parse_routes("streams:\n  - {yarp: /a, key: a}\n", "x", KINDS)
    assert routes == (
        Stream(yarp="/a", key="a", type="auto", direction="inbound", delivery="latest", depth=1),
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("streams:\n  - {yarp: /a, key: a}\n  - {yarp: /b, key: 'b c'}\n", "x:3: .*not allowed"),
        ("streams:\n  - yarp: /a\n    key: /a\n", "x:2: .*no empty chunk"),
        ("streams:\n  - {yarp: /a}\n", "x:2: .*key"),
        ("streams:\n  - {yarp: /a, key: a, type: Imagee}\n", "x:2: .*Imagee"),
        ("streams:\n  - {yarp: /a, key: a, depht: 2}\n", "x:2: .*depht"),
        ("streams:\n  - {yarp: /a, key: a, depth: many}\n", "x:2: .*int"),
        ("streams:\n  - {yarp: /a, key: a}\n\n  - {yarp: /a, key: b}\n", "x:4: .*/a.*line 2"),
        ("streams:\n  - {yarp: /a, key: a}\ncalls:\n  - {yarp: /b, key: a}\n", "x:4: .*line 2"),
        ("streams: {yarp: /a, key: a}\n", "list"),
        ("stream:\n  - {yarp: /a, key: a}\n", "control_boards"),
        ("- 1\n", "map"),
        ("streams: [\n", "no YAML"),
        ("control_boards:\n  - {yarp: icub/head, key: icub/head}\n", "x:2"),
    ],
)
def test_faults_are_named_with_their_line(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_routes(text, "x", KINDS)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        read_routes(tmp_path / "nowhere.yaml", KINDS)


def test_routes_and_settings_tell_the_dialect() -> None:
    routes = parse_routes(
        "streams:\n  - {yarp: /a, key: a, dialect: 4}\n  - {yarp: /b, key: b}\n"
        "control_boards:\n  - {yarp: /c, key: c, dialect: 3}\n",
        "x",
        KINDS,
    )
    assert dialects(YarpSettings(), routes) == {"/a": Dialect.V4, "/c": Dialect.V3}
    assert dialects(YarpSettings(dialect="4"), routes)["/"] is Dialect.V4
    with pytest.raises(ConfigError, match="x:2"):
        parse_routes("streams:\n  - {yarp: /a, key: a, dialect: 5}\n", "x", KINDS)
