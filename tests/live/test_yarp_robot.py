"""The simulated robot through the adapter: YARP wire on one side, backbone on the other."""

from __future__ import annotations

import asyncio
import json
import time
from array import array
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import ENCODING, CodecRegistry
from vertebra.errors import RemoteError
from vertebra.messages import (
    Array,
    AudioChunk,
    Header,
    Image,
    Imu,
    JointCommand,
    JointState,
    Message,
)
from vertebra.service import MessagePublisher, MessageReader, run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import NameClient
from vertebra_simulator.adapter import serve as simulate
from vertebra_simulator.settings import SimulatorSettings
from vertebra_yarp.adapter import serve
from vertebra_yarp.settings import YarpSettings

pytestmark = pytest.mark.live

ROUTES = Path(__file__).parents[2] / "deploy" / "yarp" / "routes.yaml"


@dataclass
class Lab:
    """The adapter with its name server, the simulated robot, and the backbone they are on."""

    network: MemoryNetwork
    bus: MemoryBus
    codecs: CodecRegistry
    tcp_port: int
    robot: asyncio.Task[None]

    @property
    def names(self) -> NameClient:
        return NameClient("127.0.0.1", self.tcp_port)

    async def call(self, key: str, body: Any = None, timeout_s: float = 5) -> Any:
        payload = b"" if body is None else json.dumps(body).encode()
        reply = await self.bus.call(
            f"vizzy/{key}", payload, encoding="application/json", timeout_s=timeout_s
        )
        return json.loads(reply.payload)

    async def refusal(self, key: str, body: Any) -> str:
        with pytest.raises(RemoteError) as caught:
            await self.call(key, body)
        assert caught.value.kind == "CommandRefusedError"
        return caught.value.detail

    def read(self, key: str, wanted: type[Message] = Message) -> MessageReader[Message]:
        return MessageReader(
            self.bus.subscribe(f"vizzy/{key}", Delivery.latest()), self.codecs, wanted
        )

    async def play(self, chunk: AudioChunk) -> Any:
        payload, encoding = self.codecs.encode(chunk, Header(), encoding=ENCODING)
        reply = await self.bus.call(
            "vizzy/speaker/play", bytes(payload), encoding=encoding, timeout_s=5
        )
        return json.loads(reply.payload)

    def start_robot(self) -> None:
        settings = SimulatorSettings(name_server=f"127.0.0.1:{self.tcp_port}")
        self.robot = asyncio.create_task(
            run_service("simulator", settings, simulate, bus=MemoryBus(self.network))
        )

    async def stop_robot(self) -> None:
        self.robot.cancel()
        await asyncio.wait([self.robot], timeout=5)

    async def reached(self) -> None:
        async with self.bus.presence("@vertebra/parts/vizzy/head") as presence:
            await asyncio.wait_for(anext(presence), 10)
        async with asyncio.timeout(10):  # the last of its ports
            while await self.names.query("/vizzy/microphone/audio:o") is None:
                await asyncio.sleep(0.02)


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    network = MemoryNetwork()
    tcp_port = free_tcp_port()
    settings = YarpSettings(name_server_bind=f"127.0.0.1:{tcp_port}", routes=ROUTES)
    adapter = asyncio.create_task(run_service("yarp", settings, serve, bus=MemoryBus(network)))
    bus = MemoryBus(network)
    lab = Lab(network, bus, CodecRegistry.installed(), tcp_port, adapter)
    lab.start_robot()
    await lab.reached()
    yield lab
    await lab.stop_robot()
    adapter.cancel()
    await asyncio.wait([adapter], timeout=5)
    await bus.close()
    assert adapter.done()


async def test_limits_come_from_the_robot(lab: Lab) -> None:
    limits = {joint["name"]: joint for joint in (await lab.call("head/limits"))["joints"]}
    assert limits["neck_pitch"] == {
        "name": "neck_pitch",
        "min_deg": -30.0,
        "max_deg": 22.0,
        "max_velocity_deg_s": 100.0,
        "min_velocity_deg_s": -100.0,
    }


async def test_moves_absolute_and_relative_say_what_was_reached(lab: Lab) -> None:
    done = await lab.call("head/move", {"positions_deg": {"neck_yaw": 20}, "velocity_deg_s": 90})
    assert done["reached"]
    assert done["positions_deg"]["neck_yaw"] == pytest.approx(20, abs=0.1)
    done = await lab.call("head/move_by", {"changes_deg": {"neck_yaw": -5}})
    assert done["targets_deg"]["neck_yaw"] == pytest.approx(15, abs=0.1)
    assert done["positions_deg"]["neck_yaw"] == pytest.approx(15, abs=0.1)
    assert (await lab.call("head/speeds"))["speeds_deg_s"]["neck_yaw"] == 90
    assert "neck_yaw = 65 deg is outside its limits, -50 to 50 deg" in await lab.refusal(
        "head/move_by", {"changes_deg": {"neck_yaw": 50}}
    )


async def test_velocity_stops_by_itself_when_no_new_command_comes(lab: Lab) -> None:
    told = await lab.call("head/velocity", {"velocities_deg_s": {"neck_yaw": 40}, "for_s": 0.3})
    assert told["stops_in_s"] == 0.3
    await asyncio.sleep(0.15)
    assert (await lab.call("head/modes"))["modes"]["neck_yaw"] == "velocity"
    await asyncio.sleep(0.5)
    first = (await lab.call("head/move_by", {"changes_deg": {"neck_roll": 0}}))["positions_deg"]
    assert 5 < first["neck_yaw"] < 45, "it ran for 0.3 s at 40 deg/s, not on to its limit"
    await asyncio.sleep(0.2)
    later = await lab.call("head/velocity", {"velocities_deg_s": {"neck_roll": 0.0}})
    assert later["positions_deg"]["neck_yaw"] == first["neck_yaw"]


async def test_velocity_goes_on_while_it_is_repeated(lab: Lab) -> None:
    told: Any = None
    for _ in range(8):
        told = await lab.call("head/velocity", {"velocities_deg_s": {"neck_yaw": 40}, "for_s": 0.2})
        await asyncio.sleep(0.1)
    assert told["positions_deg"]["neck_yaw"] > 20


async def test_joint_that_is_not_named_any_more_stops(lab: Lab) -> None:
    async def yaw_deg(**velocities_deg_s: float) -> float:
        command = {"velocities_deg_s": velocities_deg_s, "for_s": 5}
        told = await lab.call("head/velocity", command)
        return float(told["positions_deg"]["neck_yaw"])

    async with asyncio.timeout(10):
        while await yaw_deg(neck_yaw=10) < 1:
            await asyncio.sleep(0.02)
        before, now = 0.0, await yaw_deg(neck_roll=1)
        while now != before:  # it brakes
            await asyncio.sleep(0.1)
            before, now = now, await yaw_deg(neck_roll=1)
    assert now < 40, "it stopped, and not at its limit"


async def test_a_move_ends_what_runs(lab: Lab) -> None:
    await lab.call("head/velocity", {"velocities_deg_s": {"neck_yaw": 30}, "for_s": 5})
    await lab.call("head/move", {"positions_deg": {"neck_roll": 5}})
    before = await lab.call("head/stop")
    await asyncio.sleep(0.3)
    assert await lab.call("head/stop") == before


async def test_direct_positions_go_at_once_and_only_in_small_steps(lab: Lab) -> None:
    await lab.call("head/direct", {"positions_deg": {"eyes_tilt": 4, "neck_yaw": -3}})
    await asyncio.sleep(0.4)
    there = (await lab.call("head/stop"))["positions_deg"]
    assert (there["eyes_tilt"], there["neck_yaw"]) == (4, -3)
    assert (await lab.call("head/modes"))["modes"]["eyes_tilt"] == "direct"
    assert "23 deg away, more than 10 deg at once" in await lab.refusal(
        "head/direct", {"positions_deg": {"neck_yaw": 20}}
    )


async def test_modes_and_speeds_are_set_and_read(lab: Lab) -> None:
    told = await lab.call("head/modes", {"modes": {"neck_yaw": "idle"}})
    assert told["modes"] == {
        "neck_pitch": "position",
        "neck_roll": "position",
        "neck_yaw": "idle",
        "eyes_tilt": "position",
        "eyes_version": "position",
        "eyes_vergence": "position",
    }
    assert "'torque': the modes are position" in await lab.refusal(
        "head/modes", {"modes": {"neck_yaw": "torque"}}
    )
    told = await lab.call("head/speeds", {"speeds_deg_s": {"neck_yaw": 12.5}})
    assert told["speeds_deg_s"]["neck_yaw"] == 12.5
    assert "neck_yaw at 101 deg/s is outside its limits, above 0 to 100 deg/s" in await lab.refusal(
        "head/speeds", {"speeds_deg_s": {"neck_yaw": 101}}
    )


async def test_state_has_velocities_because_the_robot_has_state_ext(lab: Lab) -> None:
    async with asyncio.timeout(10):
        await lab.call("head/velocity", {"velocities_deg_s": {"neck_yaw": 20}, "for_s": 2})
        async for received in lab.read("head/state", JointState):
            state = received.message
            assert isinstance(state, JointState)
            assert state.names[2] == "neck_yaw"
            assert state.efforts_nm == ()
            if state.velocities_deg_s[2] > 15:
                break
    assert abs(received.header.captured_ns - time.time_ns()) < 1e9


async def test_state_is_that_of_state_ext_as_soon_as_a_starting_robot_has_it(lab: Lab) -> None:
    contact = await lab.names.query("/vizzy/head/stateExt:o")
    assert contact is not None
    await lab.names.unregister(contact.name)
    states = aiter(lab.read("head/state", JointState))
    async with asyncio.timeout(10):
        plain = (await anext(states)).message
        await lab.names.register(contact.name, host=contact.host, tcp_port=contact.tcp_port)
        while not (await anext(states)).message.velocities_deg_s:  # type: ignore[attr-defined]
            pass
    assert isinstance(plain, JointState)
    assert plain.velocities_deg_s == ()


async def test_streamed_commands_move_the_joints_and_bad_ones_are_reported(lab: Lab) -> None:
    publisher = MessagePublisher(lab.bus, lab.codecs, "vizzy/head/command")
    statuses = MessageReader(
        lab.bus.subscribe("@vertebra/services/yarp/1/status", Delivery.latest()),
        lab.codecs,
        Message,
    )
    for step in range(1, 11):
        publisher.publish(JointCommand(names=("neck_yaw",), positions_deg=(step,), mode="direct"))
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.4)
    assert (await lab.call("head/stop"))["positions_deg"]["neck_yaw"] == 10
    publisher.publish(JointCommand(names=("neck_yaw",), velocities_deg_s=(500.0,)))
    async with asyncio.timeout(5):
        async for received in statuses:
            if "neck_yaw = 500 deg/s is outside its limits" in str(received.message):
                break
    metrics = await lab.bus.call("@vertebra/services/yarp/1/metrics", timeout_s=5)
    assert b"vertebra_yarp_refused_total 1.0" in metrics.payload


async def test_gaze_turns_to_points_angles_and_pixels_and_says_where_it_looks(lab: Lab) -> None:
    told = await lab.call("gaze/look", {"azimuth_deg": -15, "elevation_deg": 5})
    assert told["reached"]
    assert told["angles_deg"]["azimuth"] == pytest.approx(-15, abs=0.1)
    assert told["angles_deg"]["elevation"] == pytest.approx(5, abs=0.1)
    told = await lab.call("gaze/look", {"azimuth_deg": 5, "relative": True})
    assert told["angles_deg"]["azimuth"] == pytest.approx(-10, abs=0.1)
    told = await lab.call("gaze/look_at", {"point_m": [1.0, 0.2, 0.1]})
    assert told["point_m"] == pytest.approx([1.0, 0.2, 0.1], abs=0.02)
    told = await lab.call("gaze/look_at_pixel", {"u_px": 160, "v_px": 120, "distance_m": 1.0})
    assert told["reached"]
    told = await lab.call("gaze/look", {"azimuth_deg": 40, "wait": False})
    assert not told["reached"]
    stopped = await lab.call("gaze/stop")
    assert stopped["angles_deg"]["azimuth"] < 35
    assert "azimuth_deg" in await lab.refusal("gaze/look", {"azimuth_deg": 400})
    assert "point_m" in await lab.refusal("gaze/look_at", {"point_m": [1, 2]})


async def test_face_shows_expressions_in_words_that_people_know(lab: Lab) -> None:
    told = await lab.call("face/express", {"expression": "happy"})
    assert told == {"expression": "happy", "part": "all", "answer": "[ok]"}
    await lab.call("face/express", {"expression": "surprised", "part": "mouth"})
    assert "'glad'; known: neutral, happy" in await lab.refusal(
        "face/express", {"expression": "glad"}
    )
    assert "'nose'; known: all, mouth" in await lab.refusal(
        "face/express", {"expression": "sad", "part": "nose"}
    )
    async with asyncio.timeout(5):
        image = await anext(aiter(lab.read("face/image", Image)))
    assert isinstance(image.message, Image)
    assert (image.message.width, image.message.height) == (160, 120)


async def test_what_is_played_is_heard(lab: Lab) -> None:
    microphone = lab.read("microphone", AudioChunk)
    listening = aiter(microphone)
    async with asyncio.timeout(5):
        await anext(listening)
    samples = array("h", [3000, 1000] * 16_000)  # one second of two channels
    chunk = AudioChunk(samples=Array(samples, "<i2", (16_000, 2)), rate_hz=16_000)
    assert await lab.play(chunk) == {"taken": True, "duration_s": 1.0, "rate_hz": 16000}
    async with asyncio.timeout(5):
        while max(max((await anext(listening)).message.samples.tolist())) != 3000:  # type: ignore[attr-defined]
            pass
    with pytest.raises(RemoteError, match="32 s of sound is longer than 30 s"):
        await lab.play(AudioChunk(samples=Array(bytes(64_000), "<i2", (32_000, 1)), rate_hz=1000))


async def test_sound_that_streams_to_the_speaker_is_heard(lab: Lab) -> None:
    listening = aiter(lab.read("microphone", AudioChunk))
    publisher = MessagePublisher(lab.bus, lab.codecs, "vizzy/speaker/audio")
    async with asyncio.timeout(5):
        await anext(listening)
        for _ in range(3):
            samples = array("h", [500] * 800)
            publisher.publish(AudioChunk(samples=Array(samples, "<i2", (800, 1)), rate_hz=16_000))
        while max(max((await anext(listening)).message.samples.tolist())) != 500:  # type: ignore[attr-defined]
            pass


async def test_both_kinds_of_inertial_ports_tell_the_same(lab: Lab) -> None:
    async with asyncio.timeout(5):
        old = (await anext(aiter(lab.read("imu", Imu)))).message
        new = (await anext(aiter(lab.read("head/inertials", Imu)))).message
    assert isinstance(old, Imu)
    assert isinstance(new, Imu)
    assert new.linear_acceleration_m_s2 == pytest.approx(old.linear_acceleration_m_s2)
    assert new.magnetic_field_ut == pytest.approx(old.magnetic_field_ut)
    assert new.orientation_xyzw == pytest.approx(old.orientation_xyzw)


async def test_devices_that_are_away_say_so(lab: Lab) -> None:
    await lab.stop_robot()
    for call, body in {
        "gaze/look": {"azimuth_deg": 1},
        "face/express": {"expression": "happy"},
    }.items():
        with pytest.raises(RemoteError, match="/vizzy/") as caught:
            await lab.call(call, body)
        assert caught.value.kind == "NotConnectedError"


async def test_lost_board_says_why_and_comes_back(lab: Lab) -> None:
    await lab.stop_robot()
    with pytest.raises(RemoteError, match="/vizzy/head/rpc:i") as caught:
        await lab.call("head/move", {"positions_deg": {"neck_yaw": 5}})
    assert caught.value.kind == "NotConnectedError"
    lab.start_robot()
    await lab.reached()
    await eventually(lambda: not lab.robot.done())
    assert (await lab.call("head/move", {"positions_deg": {"neck_yaw": 5}}))["reached"]
