"""The gateway's REST, held to PROTOCOL.md, on a backbone in memory."""

from __future__ import annotations

import asyncio
import io
import json
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import PIL.Image
import pytest
from jsonschema import Draft202012Validator
from prometheus_client.parser import text_string_to_metric_families

from vertebra.bus import Handler, MemoryBus, MemoryNetwork, Reply, Request
from vertebra.codec import CodecRegistry
from vertebra.errors import (
    BusyError,
    CommandRefusedError,
    DeadlineError,
    DecodeError,
    NotConnectedError,
    VertebraError,
)
from vertebra.messages import Status, Text
from vertebra.service import MessagePublisher, service_key
from vertebra.testing.bus_suite import eventually
from vertebra_gateway import bodies, rest
from vertebra_gateway.app import make_app
from vertebra_gateway.auth import Guard
from vertebra_gateway.fleet import Fleet
from vertebra_gateway.problems import problem_of
from vertebra_gateway.profile import load_profiles
from vertebra_gateway.resources import Robots
from vertebra_gateway.rest import Gateway
from vertebra_gateway.streams import Streams
from vertebra_gateway.testing import JOINTS, FakeRobot
from vertebra_gateway.ws import Clients

TOKEN = "0123456789abcdef"
BEARER = {"authorization": f"Bearer {TOKEN}"}
CODECS = CodecRegistry.installed()
PROFILES = load_profiles(Path(__file__).parents[2] / "deploy" / "robots")
MOVE = "/api/robots/vizzy/head/move"


@dataclass
class Rig:
    """A gateway, its web client, and the robot behind it."""

    gateway: Gateway
    http: httpx.AsyncClient
    bus: MemoryBus
    codecs: CodecRegistry
    robot: FakeRobot

    async def get(self, path: str, **headers: str) -> httpx.Response:
        return await self.http.get(path, headers={**BEARER, **headers})

    async def post(self, path: str, body: Any) -> httpx.Response:
        return await self.http.post(path, json=body, headers=BEARER)

    async def wait_online(self, *, online: bool = True) -> None:
        await eventually(lambda: self.gateway.robots.robot("vizzy").online is online)

    async def publish_until(self, request: Any, publish: Any) -> httpx.Response:
        """Answer a request that subscribes on demand: publish while it waits."""
        waiting = asyncio.ensure_future(request)
        while not waiting.done():
            publish()
            await asyncio.sleep(0.01)
        response: httpx.Response = await waiting
        return response


@asynccontextmanager
async def running(*, jpeg_quality: int = 80) -> AsyncIterator[Rig]:
    network = MemoryNetwork()
    inside, outside = MemoryBus(network), MemoryBus(network)
    codecs = CODECS
    robot = FakeRobot(outside, codecs)
    async with asyncio.TaskGroup() as tasks:
        streams = Streams(inside, codecs, tasks, jpeg_quality=jpeg_quality)
        robots = Robots(inside, codecs, PROFILES)
        fleet = Fleet(inside, codecs)
        clients = Clients(streams, robots)
        gateway = Gateway(
            bus=inside, codecs=codecs, robots=robots, streams=streams, fleet=fleet, clients=clients
        )
        streams.keep("vizzy/head/state", 60.0)
        followers = [tasks.create_task(robots.follow()), tasks.create_task(fleet.follow())]
        transport = httpx.ASGITransport(make_app(gateway, Guard(TOKEN)), raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://gateway") as http:
            yield Rig(gateway, http, outside, codecs, robot)
        streams.close()
        for follower in followers:
            follower.cancel()
    await inside.close()
    await outside.close()


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running() as started:
        await started.wait_online()
        yield started


def problem(response: httpx.Response, status: int) -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert document["status"] == status
    assert document["type"]
    assert document["title"]
    return document


async def test_robots_are_listed_with_what_they_offer(rig: Rig) -> None:
    (robot,) = (await rig.get("/api/robots")).json()
    assert (robot["name"], robot["online"], robot["reason"]) == ("vizzy", True, "")
    move = next(found for found in robot["resources"] if found["path"] == "head/move")
    assert (move["kind"], move["method"], move["url"]) == ("call", "POST", MOVE)
    assert move["limits"]["positions_deg"]["neck_yaw"] == {
        "min": -30.0,
        "max": 30.0,
        "unit": "deg",
    }
    assert move["limits"]["velocity_deg_s"]["neck_yaw"] == {"max": 100.0, "unit": "deg/s"}
    assert (await rig.get("/api/robots/vizzy")).json() == robot


async def test_a_value_is_read_with_its_age(rig: Rig) -> None:
    rig.robot.publish_state()
    before_ns = time.time_ns()
    document = (await rig.get("/api/robots/vizzy/head/joints")).json()
    assert (document["key"], document["schema"]) == ("vizzy/head/state", "vertebra/JointState/1")
    assert 0 <= before_ns - int(document["captured_ns"]) < 5e9
    assert 0 <= document["age_s"] < 5
    assert document["message"]["names"] == list(JOINTS)


async def test_a_value_is_read_only_for_a_while_after_somebody_asked(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rest, "READ_KEPT_S", 0.6)
    network = rig.bus.network
    before = len(network.subscriptions)
    imu = MessagePublisher(rig.bus, rig.codecs, "vizzy/imu")
    path = "/api/robots/vizzy/imu"
    response = await rig.publish_until(rig.get(path), lambda: imu.publish(Text(text="first")))
    assert response.json()["message"]["text"] == "first"
    imu.publish(Text(text="second"))
    await asyncio.sleep(0.3)
    assert len(network.subscriptions) == before + 1
    assert (await rig.get(path)).json()["message"]["text"] == "second"  # and is kept anew
    await asyncio.sleep(0.4)
    assert len(network.subscriptions) == before + 1
    with rig.gateway.streams.viewing("vizzy/imu", "frame"):
        await asyncio.sleep(0.6)
        assert len(network.subscriptions) == before + 1, "somebody looks"
    assert len(network.subscriptions) == before


async def test_a_snapshot_is_the_newest_image(rig: Rig) -> None:
    captured: list[int] = []
    response = await rig.publish_until(
        rig.get("/api/robots/vizzy/camera/left"),
        lambda: captured.append(rig.robot.publish_image(77)),
    )
    assert response.headers["content-type"] == "image/jpeg"
    assert int(response.headers["x-captured-ns"]) in captured
    assert 0 <= float(response.headers["x-age-s"]) < 5
    image = PIL.Image.open(io.BytesIO(response.content))
    pixel = image.getpixel((160, 120))
    assert image.size == (320, 240)
    assert isinstance(pixel, tuple)
    assert all(abs(channel - 77) <= 2 for channel in pixel)


async def test_a_camera_that_sends_nothing_is_503_with_the_reason(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rest, "FIRST_VALUE_WITHIN_S", 0.05)
    for path in ("camera/left", "camera/left/stream", "imu"):
        response = await rig.get(f"/api/robots/vizzy/{path}")
        assert "nothing came on 'vizzy/" in problem(response, 503)["detail"]
        assert int(response.headers["retry-after"]) >= 1


async def test_a_snapshot_is_never_an_old_image(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rest, "FIRST_VALUE_WITHIN_S", 0.3)
    monkeypatch.setattr(rest, "IMAGE_MAX_AGE_S", 0.1)
    with rig.gateway.streams.viewing("vizzy/camera/left", "jpeg") as viewer:
        rig.robot.publish_image()
        await viewer.next()
        await asyncio.sleep(0.2)
        problem(await rig.get("/api/robots/vizzy/camera/left"), 503)


async def test_what_comes_on_a_camera_key_and_is_no_image_is_422(rig: Rig) -> None:
    publisher = MessagePublisher(rig.bus, rig.codecs, "vizzy/camera/left")
    response = await rig.publish_until(
        rig.get("/api/robots/vizzy/camera/left"), lambda: publisher.publish(Text(text="x"))
    )
    assert "Text is no image" in problem(response, 422)["detail"]


async def test_what_cannot_be_decoded_is_502(rig: Rig) -> None:
    publisher = rig.bus.publisher("vizzy/imu", encoding="application/vnd.vertebra.frame")
    response = await rig.publish_until(
        rig.get("/api/robots/vizzy/imu"), lambda: publisher.put(b"rubbish")
    )
    problem(response, 502)


async def test_a_move_tells_where_the_robot_is(rig: Rig) -> None:
    response = await rig.post(MOVE, {"positions_deg": {"neck_yaw": 20}, "wait": True})
    assert response.status_code == 200
    assert response.json()["reached"] is True
    assert response.json()["positions_deg"]["neck_yaw"] == 20
    assert rig.robot.moves == [{"positions_deg": {"neck_yaw": 20}, "wait": True}]


async def test_a_call_by_get_and_one_without_input(rig: Rig) -> None:
    limits = (await rig.get("/api/robots/vizzy/head/limits")).json()
    assert [joint["name"] for joint in limits["joints"]] == list(JOINTS)
    response = await rig.http.post("/api/robots/vizzy/head/stop", headers=BEARER)
    assert set(response.json()["positions_deg"]) == set(JOINTS)


@pytest.mark.parametrize(
    ("body", "more"),
    [
        (
            b'{"positions_deg": {"neck_yaw": 31}}',
            {
                "joint": "neck_yaw",
                "value": 31,
                "limit": {"min": -30.0, "max": 30.0, "unit": "deg"},
            },
        ),
        (
            b'{"positions_deg": {"neck_yaw": 1}, "velocity_deg_s": 101}',
            {"joint": "neck_yaw", "value": 101, "limit": {"max": 100.0, "unit": "deg/s"}},
        ),
        (b'{"positions_deg": {"elbow": 1}}', {"joint": "elbow", "known": sorted(JOINTS)}),
        (b'{"positions_deg": {"neck_yaw": "1"}}', {"path": "positions_deg/neck_yaw"}),
        (b'{"positions_deg": {}}', {"path": "positions_deg"}),
        (b"{}", {"path": ""}),
        (b"", {"path": ""}),
        (b"[]", {}),
        (b"{", {}),
        (b'{"positions_deg": {"neck_yaw": NaN}}', {}),
        (b'{"positions_deg": {"neck_yaw": 1e999}}', {}),
        (b"\xff\xfe", {}),
        (b"[" * 100_000, {}),
    ],
)
async def test_an_input_outside_schema_or_limits_is_422_and_reaches_no_robot(
    rig: Rig, body: bytes, more: dict[str, Any]
) -> None:
    response = await rig.http.post(MOVE, content=body, headers=BEARER)
    document = problem(response, 422)
    assert document.items() >= more.items()
    assert document["detail"]
    assert rig.robot.moves == []


async def test_a_body_that_is_too_long_is_413(rig: Rig) -> None:
    body = b'{"positions_deg": {"neck_yaw": 1}, "x": "' + b"x" * bodies.MAX_BODY_BYTES + b'"}'
    problem(await rig.http.post(MOVE, content=body, headers=BEARER), 413)
    assert rig.robot.moves == []


@pytest.mark.parametrize(
    ("failure", "status"),
    [
        (CommandRefusedError("the board says no"), 422),
        (BusyError("the board", 4), 429),
        (NotConnectedError("the board is off"), 503),
        (DeadlineError("the board", 2.0), 504),
        (ZeroDivisionError("a bug"), 502),
    ],
)
async def test_errors_of_the_robot_have_their_status(
    rig: Rig, failure: VertebraError, status: int
) -> None:
    rig.robot.failure = failure
    response = await rig.post("/api/robots/vizzy/head/stop", {})
    assert str(failure) in problem(response, status)["detail"]
    assert ("retry-after" in response.headers) is (status in (429, 503))


async def never(_: Request) -> Reply:
    await asyncio.sleep(60)
    raise AssertionError


async def rubbish(_: Request) -> Reply:
    return Reply(payload=b"\x00", encoding="application/json")


@pytest.mark.parametrize(
    ("handler", "error", "status"), [(never, DeadlineError, 504), (rubbish, DecodeError, 502)]
)
async def test_late_and_unreadable_answers(
    rig: Rig, handler: Handler, error: type[VertebraError], status: int
) -> None:
    rig.robot.close()  # the call below begins before the news of its leaving gets through
    rig.bus.serve("vizzy/head/stop", handler)
    with pytest.raises(error) as caught:
        await rig.gateway.robots.call("vizzy", "head/stop", {}, 0.05)
    assert problem_of(caught.value).status == status


@pytest.mark.parametrize(
    ("path", "known"),
    [
        ("/api/robots/nobody", ["vizzy"]),
        ("/api/robots/nobody/head/joints", ["vizzy"]),
        ("/api/robots/vizzy/tail", "head/joints"),
        ("/api/robots/vizzy/tail/stream", "head/joints"),
    ],
)
async def test_unknown_names_are_404_and_tell_the_known(
    rig: Rig, path: str, known: list[str] | str
) -> None:
    document = problem(await rig.get(path), 404)
    assert document["known"] == known or known in document["known"]


@pytest.mark.parametrize(
    ("method", "path", "status", "allow"),
    [
        ("GET", MOVE, 405, "POST"),
        ("POST", "/api/robots/vizzy/head/joints", 405, "GET"),
        ("POST", "/api/robots/vizzy/head/limits", 405, "GET"),
        ("POST", "/api/robots/vizzy/head/joints/stream", 404, None),
        ("GET", f"{MOVE}/stream", 404, None),
        ("DELETE", MOVE, 405, None),
        ("GET", "/nowhere", 404, None),
        ("GET", "/../../etc/passwd", 404, None),
    ],
)
async def test_other_methods_and_paths(
    rig: Rig, method: str, path: str, status: int, allow: str | None
) -> None:
    response = await rig.http.request(method, path, headers=BEARER)
    problem(response, status)
    assert allow is None or response.headers["allow"] == allow


async def test_a_robot_that_is_away_stays_listed_and_answers_503_with_the_reason(rig: Rig) -> None:
    rig.robot.close()
    await rig.wait_online(online=False)
    (robot,) = (await rig.get("/api/robots")).json()
    assert robot["reason"] == "nobody is present at @vertebra/parts/vizzy/**"
    for path in ("head/joints", "camera/left", "camera/left/stream", "head/limits"):
        response = await rig.get(f"/api/robots/vizzy/{path}")
        assert robot["reason"] in problem(response, 503)["detail"]
        assert "retry-after" in response.headers
    problem(await rig.post(MOVE, {"positions_deg": {"neck_yaw": 1}}), 503)
    document = (await rig.get("/openapi.json")).json()
    assert robot["reason"] in document["paths"][MOVE]["post"]["description"]

    FakeRobot(rig.bus, rig.codecs)
    await rig.wait_online()
    assert (await rig.post(MOVE, {"positions_deg": {"neck_yaw": 1}})).status_code == 200


async def test_a_robot_whose_limits_cannot_be_had_is_not_online(rig: Rig) -> None:
    rig.robot.failure = NotConnectedError("the head is switched off")
    await rig.wait_online(online=False)
    assert "switched off" in (await rig.get("/api/robots/vizzy")).json()["reason"]
    rig.robot.failure = None
    await rig.wait_online()


async def test_a_bug_is_a_problem_too(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig.gateway.robots, "describe", lambda: 1 // 0)
    response = await rig.get("/api/robots")
    assert "ZeroDivisionError" in problem(response, 500)["detail"]
    assert "content-security-policy" in response.headers


async def test_health_needs_no_token_and_everything_else_does(rig: Rig) -> None:
    for path in ("/healthz", "/readyz"):
        assert (await rig.http.get(path)).status_code == 200
    for path in ("/", "/api/robots", "/api/fleet", "/metrics", "/openapi.json", "/docs", "/ws"):
        response = await rig.http.get(path)
        problem(response, 401)
        assert response.headers["www-authenticate"] == "Bearer"
    problem(await rig.http.get("/api/robots", headers={"authorization": "Bearer no"}), 401)


async def test_another_origin_is_403(rig: Rig) -> None:
    problem(await rig.get("/api/robots", origin="http://evil.org"), 403)
    assert (await rig.get("/api/robots", origin="http://gateway")).status_code == 200


async def test_the_address_with_the_token_sets_a_cookie_that_scripts_cannot_read(rig: Rig) -> None:
    response = await rig.http.get(f"/?token={TOKEN}")
    assert (response.status_code, response.headers["location"]) == (303, "/")
    cookie = response.headers["set-cookie"]
    assert cookie == f"vertebra_token={TOKEN}; Path=/; HttpOnly; SameSite=Strict"
    assert (await rig.http.get("/api/robots")).status_code == 200  # httpx keeps the cookie
    rig.http.cookies.clear()
    response = await rig.http.get("/?token=wrong")
    problem(response, 401)
    assert "set-cookie" not in response.headers


async def test_every_answer_carries_the_security_headers(rig: Rig) -> None:
    for path in ("/healthz", "/api/robots", "/nowhere", "/vertebra.js"):
        headers = (await rig.get(path)).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"


async def test_static_files_are_asked_for_again_and_have_their_type(rig: Rig) -> None:
    response = await rig.get("/vertebra.js")
    assert response.headers["content-type"].startswith(
        ("text/javascript", "application/javascript")
    )
    assert response.headers["cache-control"] == "no-cache"
    again = await rig.get("/vertebra.js", **{"if-none-match": response.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["cache-control"] == "no-cache"


async def test_readyz_tells_when_the_backbone_is_gone(rig: Rig) -> None:
    await rig.gateway.bus.close()
    response = await rig.http.get("/readyz")
    assert "router" in problem(response, 503)["detail"]
    assert (await rig.http.get("/healthz")).status_code == 200


async def test_the_fleet_shows_services_streams_and_clients(rig: Rig) -> None:
    async def info(_: Request) -> Reply:
        return Reply(payload=b'{"version": "1.2.3"}', encoding="application/json")

    rig.bus.serve(service_key("lamp", "2", "info"), info)
    alive = rig.bus.declare_presence(service_key("lamp", "2", "alive"))
    status = MessagePublisher(rig.bus, rig.codecs, service_key("lamp", "2", "status"))
    status.publish(Status(level="warning", text="dim", values={"lumen": 3}))
    for _ in range(3):
        rig.robot.publish_state()
        await asyncio.sleep(0.01)

    async def lamp() -> dict[str, Any]:
        document = (await rig.get("/api/fleet")).json()
        return next((row for row in document["services"] if row["service"] == "lamp"), {})

    async with asyncio.timeout(5):
        while not (row := await lamp()).get("version"):
            await asyncio.sleep(0.01)
    assert row["status_age_s"] >= 0
    del row["status_age_s"]
    assert row == {
        "service": "lamp",
        "instance": "2",
        "present": True,
        "version": "1.2.3",
        "status": {"level": "warning", "text": "dim", "values": {"lumen": 3}},
    }
    document = (await rig.get("/api/fleet")).json()
    (stream,) = document["streams"]
    assert (stream["key"], stream["lost"], stream["viewers"]) == ("vizzy/head/state", 0, 0)
    assert stream["encoding"] == "application/vnd.vertebra.frame;JointState/1"
    assert stream["rate_hz"] > 1
    assert 0 <= stream["age_s"] < 5
    assert document["clients"] == []
    alive.close()
    async with asyncio.timeout(5):
        while (await lamp())["present"]:
            await asyncio.sleep(0.01)


async def test_metrics_of_all_services_do_not_clash(rig: Rig) -> None:
    def serve(name: str, text: str) -> None:
        async def metrics(_: Request) -> Reply:
            return Reply(payload=text.encode(), encoding="text/plain")

        rig.bus.serve(service_key(name, "1", "metrics"), metrics)

    same = "# HELP vertebra_beats_total Beats\n# TYPE vertebra_beats_total counter\n"
    serve("lamp", f"{same}vertebra_beats_total 3\n")
    serve("drum", f'{same}vertebra_beats_total{{stick="left"}} 4\n')
    serve("broken", "this is { no metric\n")
    text = (await rig.get("/metrics")).text
    families = {family.name: family for family in text_string_to_metric_families(text)}
    found = {
        (sample.labels["service"], sample.labels.get("stick"), sample.value)
        for sample in families["vertebra_beats"].samples
    }
    assert found == {("lamp", None, 3.0), ("drum", "left", 4.0)}


async def test_openapi_has_the_paths_of_the_robots_with_their_limits(rig: Rig) -> None:
    document = (await rig.get("/openapi.json")).json()
    assert document["openapi"] == "3.1.0"
    paths = document["paths"]
    for robot in (await rig.get("/api/robots")).json():
        for resource in robot["resources"]:
            assert list(paths[resource["url"]]) == [resource["method"].lower()]
    schema = paths[MOVE]["post"]["requestBody"]["content"]["application/json"]["schema"]
    joints = schema["properties"]["positions_deg"]
    assert joints["properties"]["neck_yaw"] == {
        "type": "number",
        "description": "deg",
        "minimum": -30.0,
        "maximum": 30.0,
    }
    assert joints["additionalProperties"] is False
    assert schema["properties"]["velocity_deg_s"]["maximum"] == 100.0
    assert "/api/robots/vizzy/camera/left/stream" in paths
    names = [
        operation["operationId"]
        for operations in paths.values()
        for operation in operations.values()
    ]
    assert len(names) == len(set(names))
    Draft202012Validator.check_schema(schema)
    for component in document["components"]["schemas"].values():
        Draft202012Validator.check_schema(component)
    assert MOVE in (await rig.get("/docs")).text


@pytest.mark.parametrize(
    ("path", "component"),
    [("/api/robots/vizzy", "Robot"), ("/api/fleet", "Fleet"), ("/healthz", "Ok")],
)
async def test_answers_are_what_openapi_says(rig: Rig, path: str, component: str) -> None:
    rig.robot.publish_state()
    document = (await rig.get("/openapi.json")).json()
    schema = {
        "$ref": f"#/components/schemas/{component}",
        "components": document["components"],
    }
    Draft202012Validator(schema).validate((await rig.get(path)).json())


async def test_one_subscription_and_one_encoder_serve_all_viewers(rig: Rig) -> None:
    streams = rig.gateway.streams
    network = rig.bus.network
    before = len(network.subscriptions)
    with (
        streams.viewing("vizzy/camera/left", "jpeg") as one,
        streams.viewing("vizzy/camera/left", "jpeg") as two,
        streams.viewing("vizzy/camera/left", "frame") as raw,
    ):
        assert len(network.subscriptions) == before + 1
        for shade in range(5):
            rig.robot.publish_image(shade)
            assert await one.next() is await two.next()
            assert (await raw.next()).encoding.endswith("Image/1")
        assert streams.counts.jpegs == 5
    assert len(network.subscriptions) == before


async def test_json_documents_are_encoded_once_for_all_viewers(rig: Rig) -> None:
    streams = rig.gateway.streams
    with (
        streams.viewing("vizzy/head/state", "json") as one,
        streams.viewing("vizzy/head/state", "json") as two,
    ):
        rig.robot.publish_state()
        item = await one.next()
        assert item is await two.next()
        assert json.loads(item.payload)["schema"] == "vertebra/JointState/1"


async def test_a_late_viewer_gets_the_newest_value_with_its_age_now(rig: Rig) -> None:
    streams = rig.gateway.streams
    rig.robot.publish_state()
    with streams.viewing("vizzy/head/state", "json") as one:
        await one.next()
        await asyncio.sleep(0.1)
        with streams.viewing("vizzy/head/state", "json") as late:
            assert json.loads((await late.next()).payload)["age_s"] >= 0.1


async def test_images_that_come_faster_than_they_are_encoded_are_skipped_and_counted(
    rig: Rig,
) -> None:
    streams = rig.gateway.streams
    with streams.viewing("vizzy/camera/left", "jpeg") as viewer:
        for shade in range(20):
            rig.robot.publish_image(shade)
        counts = streams.counts
        await eventually(lambda: counts.jpegs + counts.jpegs_skipped == 20)
        newest = await viewer.next()
    shown = PIL.Image.open(io.BytesIO(newest.payload)).getpixel((1, 1))
    assert isinstance(shown, tuple)
    assert abs(shown[0] - 19) <= 2
    assert streams.counts.jpegs_skipped > 0


async def test_mjpeg_sends_parts_until_the_gateway_stops(rig: Rig) -> None:
    """Over ASGI alone; sockets and slow readers are tried in the live lane."""
    path = "/api/robots/vizzy/camera/left/stream"

    async def stop_later() -> None:
        await eventually(lambda: rig.gateway.streams.counts.jpegs > 3)
        rig.gateway.streams.close()

    stopping = asyncio.create_task(stop_later())
    response = await rig.publish_until(rig.get(path), rig.robot.publish_image)
    await stopping
    assert response.headers["content-type"].startswith("multipart/x-mixed-replace; boundary=")
    boundary = response.headers["content-type"].partition("=")[2].encode()
    parts = response.content.split(b"--" + boundary + b"\r\n")
    assert parts[0] == b""
    assert len(parts) > 2
    for part in parts[1:-1]:
        head, _, body = part.partition(b"\r\n\r\n")
        assert head.startswith(b"Content-Type: image/jpeg\r\n")
        assert b"\r\nContent-Length: %d\r\n" % (len(body) - 2) in head
