"""The simulated robot over REST: gateway, adapter and YARP wire, as a script would use them."""

from __future__ import annotations

import asyncio
import io
import wave
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import httpx
import pytest

from vertebra.bus import MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.service import run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra_gateway.app import make_app
from vertebra_gateway.auth import Guard
from vertebra_gateway.fleet import Fleet
from vertebra_gateway.profile import load_profiles
from vertebra_gateway.resources import Robots
from vertebra_gateway.rest import Gateway
from vertebra_gateway.streams import Streams
from vertebra_gateway.ws import Clients
from vertebra_simulator.adapter import serve as simulate
from vertebra_simulator.settings import SimulatorSettings
from vertebra_yarp.adapter import serve as adapt
from vertebra_yarp.settings import YarpSettings

pytestmark = pytest.mark.live

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
TOKEN: Final = "0123456789abcdef"


@dataclass
class Lab:
    """A web client of the whole fleet."""

    http: httpx.AsyncClient
    robots: Robots
    simulator: asyncio.Task[None]

    async def post(self, path: str, body: Any) -> httpx.Response:
        return await self.http.post(f"/api/robots/vizzy/{path}", json=body)

    async def did(self, path: str, body: Any) -> Any:
        response = await self.post(path, body)
        assert response.status_code == 200, response.text
        return response.json()

    async def problem(self, path: str, body: Any, status: int) -> Any:
        response = await self.post(path, body)
        assert response.status_code == status, response.text
        return response.json()


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    network = MemoryNetwork()
    names = f"127.0.0.1:{free_tcp_port()}"
    yarp = YarpSettings(name_server_bind=names, routes=DEPLOY / "yarp" / "routes.yaml")
    adapter = asyncio.create_task(run_service("yarp", yarp, adapt, bus=MemoryBus(network)))
    settings = SimulatorSettings(name_server=names)
    simulator = asyncio.create_task(
        run_service("simulator", settings, simulate, bus=MemoryBus(network))
    )
    bus, codecs = MemoryBus(network), CodecRegistry.installed()
    async with asyncio.TaskGroup() as tasks:
        streams = Streams(bus, codecs, tasks, jpeg_quality=80)
        robots = Robots(bus, codecs, load_profiles(DEPLOY / "robots"))
        fleet, clients = Fleet(bus, codecs), Clients(streams, robots)
        gateway = Gateway(
            bus=bus, codecs=codecs, robots=robots, streams=streams, fleet=fleet, clients=clients
        )
        following = tasks.create_task(robots.follow())
        transport = httpx.ASGITransport(make_app(gateway, Guard(TOKEN)), raise_app_exceptions=False)
        headers = {"authorization": f"Bearer {TOKEN}"}
        async with httpx.AsyncClient(
            transport=transport, base_url="http://gateway", headers=headers, timeout=30
        ) as http:
            await eventually(lambda: robots.robot("vizzy").online, timeout_s=15)
            yield Lab(http, robots, simulator)
        streams.close()
        following.cancel()
    for service in (simulator, adapter):
        service.cancel()
    await asyncio.wait([simulator, adapter], timeout=10)
    await bus.close()


async def test_joints_do_what_is_asked_within_the_limits_of_the_robot(lab: Lab) -> None:
    told = await lab.did("head/move_by", {"changes_deg": {"neck_yaw": 6}})
    assert told["positions_deg"]["neck_yaw"] == pytest.approx(6, abs=0.1)
    told = await lab.did("head/velocity", {"velocities_deg_s": {"neck_yaw": -10}, "for_s": 0.2})
    assert told["stops_in_s"] == 0.2
    assert (await lab.did("head/modes", {}))["modes"]["neck_yaw"] == "velocity"
    assert (await lab.did("head/speeds", {"speeds_deg_s": {"neck_yaw": 40}}))["speeds_deg_s"][
        "neck_yaw"
    ] == 40
    refused = await lab.problem("head/velocity", {"velocities_deg_s": {"neck_yaw": 101}}, 422)
    assert (refused["joint"], refused["value"]) == ("neck_yaw", 101)
    assert refused["limit"] == {"min": -100.0, "max": 100.0, "unit": "deg/s"}
    refused = await lab.problem("head/move_by", {"changes_deg": {"neck_pitch": 40}}, 422)
    assert "neck_pitch = 40 deg is outside its limits, -30 to 22 deg" in refused["detail"]
    refused = await lab.problem("head/direct", {"positions_deg": {"neck_yaw": 45}}, 422)
    assert "more than 10 deg at once" in refused["detail"]


async def test_gaze_face_and_speaker_say_what_the_robot_did(lab: Lab) -> None:
    told = await lab.did("gaze/look", {"azimuth_deg": -10})
    assert told["angles_deg"]["azimuth"] == pytest.approx(-10, abs=0.1)
    assert (await lab.did("face/express", {"expression": "sad"}))["answer"] == "[ok]"
    refused = await lab.problem("face/express", {"expression": "bored"}, 422)
    assert "known: neutral, happy" in refused["detail"]
    wav = io.BytesIO()
    with wave.open(wav, "wb") as writer:
        writer.setnchannels(1)
        writer.setsampwidth(2)
        writer.setframerate(8000)
        writer.writeframes(bytes(8000))
    response = await lab.http.post("/api/robots/vizzy/speaker/play", content=wav.getvalue())
    assert response.json() == {"taken": True, "duration_s": 0.5, "rate_hz": 8000}
    response = await lab.http.post("/api/robots/vizzy/speaker/play", content=b"music")
    assert (response.status_code, "no WAV file" in response.text) == (422, True)
    face = await lab.http.get("/api/robots/vizzy/face/image")
    assert face.headers["content-type"] == "image/jpeg"


async def test_every_call_is_in_openapi_with_the_limits_of_the_robot(lab: Lab) -> None:
    document = (await lab.http.get("/openapi.json")).json()
    velocity = document["paths"]["/api/robots/vizzy/head/velocity"]["post"]["requestBody"]
    schema = velocity["content"]["application/json"]["schema"]
    assert schema["properties"]["velocities_deg_s"]["properties"]["eyes_tilt"] == {
        "type": "number",
        "description": "deg/s",
        "minimum": -180.0,
        "maximum": 180.0,
    }
    play = document["paths"]["/api/robots/vizzy/speaker/play"]["post"]["requestBody"]
    assert [*play["content"]] == ["audio/wav"]


async def test_robot_that_is_lost_is_503_with_the_reason(lab: Lab) -> None:
    lab.simulator.cancel()
    await asyncio.wait([lab.simulator], timeout=10)
    lost = await lab.problem("gaze/look", {"azimuth_deg": 1}, 503)
    assert "/vizzy/gaze/rpc" in lost["detail"] or "nobody is present" in lost["detail"]
    lost = await lab.problem("head/velocity", {"velocities_deg_s": {"neck_yaw": 1}}, 503)
    assert "vizzy" in lost["detail"]
