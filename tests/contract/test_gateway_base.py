"""A mobile base on the web: drive, watch, navigate; and a robot of which only a part is there."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any

import pytest

from vertebra.messages import Array, Native
from vertebra.service import MessagePublisher
from vertebra.testing.bus_suite import eventually
from vertebra_gateway import live, rest
from vertebra_gateway.testing import FakeBase

from .test_gateway_rest import BEARER, MOVE, Rig, problem, running

BASE = "/api/robots/vizzy/base"
AWAY = "nobody is present at @vertebra/parts/vizzy/base"
GOAL = {"pose": {"header": {"frame_id": "odom"}, "pose": {"position": {"x": 1.0, "y": 0.5}}}}


@dataclass
class Desk:
    """A gateway, and a robot with a base."""

    rig: Rig
    base: FakeBase

    async def get(self, path: str) -> Any:
        return await self.rig.get(f"{BASE}/{path}")

    async def post(self, path: str, body: Any) -> Any:
        return await self.rig.post(f"{BASE}/{path}", body)

    async def wait_for_base(self, *, there: bool = True) -> None:
        robot = self.rig.gateway.robots.robot("vizzy")
        await eventually(lambda: robot.online and ("vizzy/base" in robot.away) is not there)


@pytest.fixture
async def desk() -> AsyncIterator[Desk]:
    async with running() as rig:
        desk = Desk(rig, FakeBase(rig.bus, rig.codecs))
        await rig.wait_online()
        await desk.wait_for_base()
        yield desk


async def test_the_base_drives_and_tells_where_it_is(desk: Desk) -> None:
    command = {"linear_m_s": 0.3, "angular_deg_s": 20, "for_s": 0.5}
    answer = await desk.post("drive", command)
    assert answer.json() == {"linear_m_s": 0.3, "angular_deg_s": 20, "stops_in_s": 0.5}
    assert desk.base.drives == [command]
    response = await desk.rig.publish_until(desk.get("odometry"), lambda: desk.base.step(0.05))
    message = response.json()["message"]
    assert message["pose"]["position_m"][0] > 0
    assert message["pose"]["frame_id"] == "odom"
    scan = await desk.rig.publish_until(desk.get("scan"), lambda: desk.base.step(0.05))
    assert len(scan.json()["message"]["ranges_m"]["items"]) == 180
    assert (await desk.rig.http.post(f"{BASE}/stop", headers=BEARER)).status_code == 200
    assert desk.base.stops == 1


@pytest.mark.parametrize(
    ("body", "more"),
    [
        (
            {"linear_m_s": 0.6},
            {"joint": "base", "value": 0.6, "limit": {"min": -0.25, "max": 0.5, "unit": "m/s"}},
        ),
        ({"linear_m_s": -0.3}, {"joint": "base", "value": -0.3}),
        ({"linear_m_s": 0.1, "angular_deg_s": 91}, {"joint": "base", "value": 91}),
        ({"linear_m_s": 0.1, "for_s": 3}, {"path": "for_s"}),
        ({"linear_m_s": 0.1, "for_s": 0}, {"path": "for_s"}),
        ({"linear_m_s": [0.1, 0]}, {"path": "linear_m_s"}),
        ({"linear_ms": 0.1}, {"path": ""}),
    ],
)
async def test_a_drive_outside_the_limits_is_422_and_reaches_no_base(
    desk: Desk, body: dict[str, Any], more: dict[str, Any]
) -> None:
    document = problem(await desk.post("drive", body), 422)
    assert document.items() >= more.items()
    assert desk.base.drives == []


async def test_openapi_has_the_limits_of_the_base_and_the_schema_of_the_goal(desk: Desk) -> None:
    paths = (await desk.rig.get("/openapi.json")).json()["paths"]

    def schema(path: str) -> dict[str, Any]:
        content = paths[f"{BASE}/{path}"]["post"]["requestBody"]["content"]
        found: dict[str, Any] = content["application/json"]["schema"]
        return found

    linear = schema("drive")["properties"]["linear_m_s"]
    assert (linear["minimum"], linear["maximum"]) == (-0.25, 0.5)
    assert schema("navigate/goal")["required"] == ["pose"]
    assert "text/event-stream" in str(paths[f"{BASE}/odometry/stream"]["get"]["responses"])


async def test_a_goal_is_sent_watched_and_cancelled(desk: Desk) -> None:
    """Over ASGI alone, where a response comes as a whole: the events end with the gateway."""
    goal_id = (await desk.post("navigate/goal", GOAL)).json()["goal_id"]
    result = asyncio.ensure_future(desk.post("navigate/result", {"goal_id": goal_id}))
    living = asyncio.create_task(desk.base.live())
    events = asyncio.ensure_future(desk.get("navigate/feedback/stream"))
    await asyncio.sleep(0.3)
    answer = await desk.post("navigate/cancel", {"goal_id": goal_id})
    assert answer.json() == {"cancelling": [goal_id]}
    assert (await result).json() == {"status": "canceled", "result": {}}
    living.cancel()
    desk.rig.gateway.streams.close()
    response = await events
    assert response.headers["content-type"].startswith("text/event-stream")
    told = [
        json.loads(event.removeprefix("data: "))["message"]["value"]
        for event in response.text.split("\n\n")[:-1]
    ]
    distances = [value["feedback"]["distance_remaining"] for value in told]
    assert len(distances) > 2
    assert distances == sorted(distances, reverse=True)
    assert bytes(told[0]["goal_id"]["uuid"]["items"]).hex() == goal_id


@pytest.mark.parametrize(
    ("body", "path"),
    [({}, ""), ({"pose": {}}, "pose"), ({"pose": {"pose": {"position": {"x": "1"}}}}, None)],
)
async def test_a_goal_outside_its_schema_is_422(desk: Desk, body: Any, path: str | None) -> None:
    document = problem(await desk.post("navigate/goal", body), 422)
    assert path is None or document["path"] == path
    assert desk.base.goals == []
    problem(await desk.post("navigate/cancel", {"goal_id": "../../etc"}), 422)


async def test_events_end_with_the_problem_where_a_value_has_no_json(desk: Desk) -> None:
    many = Array(bytes(4_000_000), "|u1", (4_000_000,))
    publisher = MessagePublisher(desk.rig.bus, desk.rig.codecs, "vizzy/base/scan")
    response = await desk.rig.publish_until(
        desk.get("scan/stream"), lambda: publisher.publish(Native(value=many))
    )
    event, _, data = response.text.partition("\n")
    assert event == "event: error"
    assert json.loads(data.removeprefix("data: "))["status"] == 422


async def test_a_reader_of_events_is_told_when_nothing_comes(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "IDLE_S", 0.02)
    events = asyncio.ensure_future(desk.get("navigate/feedback/stream"))
    await asyncio.sleep(0.1)
    desk.rig.gateway.streams.close()
    assert ": nothing new\n\n" in (await events).text


async def test_a_robot_without_its_base_keeps_its_head(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rest, "FIRST_VALUE_WITHIN_S", 0.05)
    desk.base.close()
    await desk.wait_for_base(there=False)
    for response in (
        await desk.post("drive", {"linear_m_s": 0.1}),
        await desk.post("stop", {}),
        await desk.post("navigate/goal", GOAL),
        await desk.get("odometry"),
        await desk.get("navigate/feedback/stream"),
    ):
        assert AWAY in problem(response, 503)["detail"]
        assert "retry-after" in response.headers
    assert (await desk.rig.post(MOVE, {"positions_deg": {"neck_yaw": 1}})).status_code == 200

    robot = (await desk.rig.get("/api/robots/vizzy")).json()
    assert (robot["online"], robot["reason"]) == (True, "")
    reasons = {resource["path"]: resource["reason"] for resource in robot["resources"]}
    assert reasons["base/drive"] == reasons["base/navigate/goal"] == AWAY
    assert reasons["head/move"] == reasons["camera/left"] == ""
    limits = {resource["path"]: resource["limits"] for resource in robot["resources"]}
    assert limits["base/drive"]["linear_m_s"]["base"]["max"] == 0.5  # as it told them last
    paths = (await desk.rig.get("/openapi.json")).json()["paths"]
    assert AWAY in paths[f"{BASE}/drive"]["post"]["description"]

    base = FakeBase(desk.rig.bus, desk.rig.codecs)
    await desk.wait_for_base()
    assert (await desk.post("drive", {"linear_m_s": 0.1})).status_code == 200
    assert len(base.drives) == 1


async def test_a_robot_without_its_head_keeps_its_base(desk: Desk) -> None:
    desk.rig.robot.close()
    robot = desk.rig.gateway.robots.robot("vizzy")
    await eventually(lambda: "vizzy/head" in robot.away)
    assert robot.online
    assert (await desk.post("drive", {"linear_m_s": 0.1})).status_code == 200
    detail = problem(await desk.rig.post(MOVE, {"positions_deg": {"neck_yaw": 1}}), 503)["detail"]
    assert "nobody is present at @vertebra/parts/vizzy/head" in detail
    desk.base.close()
    await desk.rig.wait_online(online=False)
    assert robot.reason == "nobody is present at @vertebra/parts/vizzy/**"
