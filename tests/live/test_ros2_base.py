"""The simulated base, the adapter that drives it, and ROS nodes beside them, on loopback."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import os
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.bus.router import running_router
from vertebra.codec import CodecRegistry
from vertebra.errors import DeadlineError, RemoteError
from vertebra.messages import JointState, LaserScan, Message, Native, Odometry
from vertebra.ros2.drivers import DriverName
from vertebra.service import MessageReader, run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra_ros2.adapter import serve
from vertebra_ros2.settings import Ros2Settings

from .ros2_lab import ON_LOOPBACK, ROOT

pytestmark = pytest.mark.live

PEER = "tests.live.ros2_base_peer"
ROUTES = ROOT / "deploy/ros2/routes.yaml"
DOMAINS = itertools.cycle(range(60, 70))
SIMULATOR = """
import asyncio
from vertebra.bus import MemoryBus, MemoryNetwork
from vertebra.service import run_service
from vertebra_simulator.adapter import serve
from vertebra_simulator.settings import SimulatorSettings

bus = MemoryBus(MemoryNetwork())
asyncio.run(run_service("simulator", SimulatorSettings(), serve, bus=bus))
"""
"""The simulator alone in its process; no YARP name server is there, and none is needed."""


@dataclass
class Process:
    """Another participant, and the lines that it prints."""

    process: asyncio.subprocess.Process
    lines: list[list[Any]] = field(default_factory=list)

    async def follow(self) -> None:
        assert self.process.stdout is not None
        async for line in self.process.stdout:
            self.lines.append(json.loads(line))

    def said(self, what: str) -> list[Any]:
        """Return the values that came of a topic."""
        return [line[2] for line in self.lines if line[0] == what and len(line) == 3]

    async def until(self, what: str, fits: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the next value of a topic that fits."""
        seen = len(self.lines)

        def found() -> list[Any]:
            return [line[2:] for line in self.lines[seen:] if line[0] == what and fits(*line[2:])]

        await eventually(lambda: bool(found()), timeout_s=10)
        return found()[0]


@dataclass
class Lab:
    """A base, the adapter and the backbone."""

    bus: MemoryBus
    domain_id: int
    service: asyncio.Task[None]
    simulator: asyncio.subprocess.Process
    stack: AsyncExitStack

    def read(self, leaf: str, wanted: type[Message]) -> MessageReader[Message]:
        subscription = self.bus.subscribe(f"vizzy/base/{leaf}", Delivery.queue(1000))
        return MessageReader(subscription, CodecRegistry(), wanted)

    async def next(self, leaf: str, wanted: type[Message]) -> Any:
        reader = self.read(leaf, wanted)
        async with asyncio.timeout(5):
            received = await anext(aiter(reader))
        reader.subscription.close()
        return received.message

    async def x_m(self) -> float:
        odometry = await self.next("odometry", Odometry)
        return float(odometry.pose.position_m[0])

    async def call(self, leaf: str, timeout_s: float = 5, **fields: Any) -> Any:
        key = f"vizzy/base/{leaf}"
        payload = json.dumps(fields).encode()
        reply = await self.bus.call(key, payload, encoding="application/json", timeout_s=timeout_s)
        return json.loads(reply.payload)

    async def peer(self, role: str) -> Process:
        peer = Process(await start(self, "-m", PEER, role))
        following = asyncio.create_task(peer.follow())
        self.stack.push_async_callback(end, peer.process, following)
        await eventually(lambda: ["ready"] in peer.lines, timeout_s=10)
        return peer


async def start(lab: Lab | None, *command: str, **environment: str) -> asyncio.subprocess.Process:
    if lab is not None:
        environment["ROS_DOMAIN_ID"] = str(lab.domain_id)
    return await asyncio.create_subprocess_exec(
        sys.executable, *command, cwd=ROOT,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        env={**os.environ, "CYCLONEDDS_URI": ON_LOOPBACK, **environment},
    )  # fmt: skip


async def end(process: asyncio.subprocess.Process, following: asyncio.Task[None]) -> None:
    assert process.stdin is not None
    process.stdin.close()
    await asyncio.wait_for(process.wait(), 5)
    await following


async def simulate(domain_id: int, **environment: str) -> asyncio.subprocess.Process:
    return await start(
        None, "-c", SIMULATOR, **environment,
        VERTEBRA_SIMULATOR_NAME_SERVER="127.0.0.1:1",
        VERTEBRA_SIMULATOR_ROS2="true",
        VERTEBRA_SIMULATOR_ROS2_DOMAIN_ID=str(domain_id),
    )  # fmt: skip


@asynccontextmanager
async def running(
    routes: Path = ROUTES, driver: DriverName = "dds", router: str = ""
) -> AsyncIterator[Lab]:
    domain_id, network = next(DOMAINS), MemoryNetwork()
    bus = MemoryBus(network)
    settings = Ros2Settings(domain_id=domain_id, routes=routes, driver=driver, zenoh_router=router)
    environment = {
        "VERTEBRA_SIMULATOR_ROS2_DRIVER": driver,
        "VERTEBRA_SIMULATOR_ROS2_ZENOH_ROUTER": router,
    }
    service = asyncio.create_task(run_service("ros2", settings, serve, bus=MemoryBus(network)))
    async with AsyncExitStack() as stack:
        simulator = await simulate(domain_id, **environment)
        lab = Lab(bus, domain_id, service, simulator, stack)
        try:
            await appears(lab)
            yield lab
        finally:
            if lab.simulator.returncode is None:
                lab.simulator.terminate()
            await lab.simulator.wait()
            service.cancel()
            await asyncio.wait([service], timeout=5)
            await bus.close()
            assert service.cancelled()


async def appears(lab: Lab) -> None:
    """Wait until the base is there, and what it tells flows."""
    presence = lab.bus.presence("@vertebra/parts/vizzy/base")
    async with asyncio.timeout(20):
        async for change in presence:
            if change.present:
                break
    presence.close()
    await lab.next("odometry", Odometry)


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    async with running() as lab:
        yield lab


async def test_it_drives_and_stops_by_itself(lab: Lab) -> None:
    answer = await lab.call("drive", linear_m_s=0.4, angular_deg_s=0, for_s=1.0)
    assert answer == {"linear_m_s": 0.4, "angular_deg_s": 0.0, "stops_in_s": 1.0}
    speeds = []
    async with asyncio.timeout(10):
        async for received in lab.read("odometry", Odometry):
            assert isinstance(received.message, Odometry)
            speeds.append(received.message.twist.linear_m_s[0])
            if len(speeds) > 20 and speeds[-1] == 0:
                break
    assert max(speeds) == pytest.approx(0.4)
    # 1 s from the call, and half a second to brake; not the time that the base itself would wait
    assert len(speeds) < 1.8 * 20
    assert 0.2 < await lab.x_m() < 0.5


async def test_it_turns(lab: Lab) -> None:
    await lab.call("drive", angular_deg_s=45, for_s=1.0)
    await asyncio.sleep(1.6)
    turn = (await lab.next("odometry", Odometry)).pose.orientation_xyzw
    assert 25 < math.degrees(2 * math.atan2(turn[2], turn[3])) < 60
    joints = await lab.next("joints", JointState)
    assert joints.names == ("wheel_left_joint", "wheel_right_joint")
    assert joints.positions_deg[0] == pytest.approx(-joints.positions_deg[1])


async def test_drive_repeats_itself_and_is_silent_then(lab: Lab) -> None:
    watch = await lab.peer("watch")
    await watch.until("odom")
    assert watch.said("cmd_vel") == []
    await lab.call("drive", linear_m_s=0.2, for_s=0.5)
    await watch.until("cmd_vel", lambda twist: twist == [0.0, 0.0])
    told = watch.said("cmd_vel")
    assert told == [[0.2, 0.0]] * (len(told) - 1) + [[0.0, 0.0]]
    assert 9 <= len(told) <= 13
    await asyncio.sleep(0.5)
    assert watch.said("cmd_vel") == told


async def test_stop_beats_a_drive(lab: Lab) -> None:
    watch = await lab.peer("watch")
    await watch.until("odom")
    driving = asyncio.create_task(keep_driving(lab))
    await eventually(
        lambda: ["cmd_vel", 0.3] in [[w[0], w[2][0]] for w in watch.lines if len(w) > 2]
    )
    driving.cancel()
    began = len(watch.said("cmd_vel"))
    await lab.call("stop")
    await eventually(lambda: [0.0, 0.0] in watch.said("cmd_vel")[began:])
    after = watch.said("cmd_vel")[began:]
    assert set(map(tuple, after[after.index([0.0, 0.0]) :])) == {(0.0, 0.0)}
    await watch.until("odom", lambda odometry: odometry[5] == 0)


async def test_stop_cancels_the_navigation(lab: Lab) -> None:
    goal = await lab.call("navigate/goal", **to(3.0, -1.0))
    await moves(lab)
    assert await lab.call("stop") == {"cancelling": [goal["goal_id"]]}
    ended = await lab.call("navigate/result", **goal)
    assert ended["status"] == "canceled"
    await asyncio.sleep(1.0)  # it brakes
    odometry = await lab.next("odometry", Odometry)
    assert odometry.twist.linear_m_s[0] == 0
    await asyncio.sleep(1.5)  # longer than zero is repeated
    assert await lab.x_m() == odometry.pose.position_m[0]


async def test_it_navigates_around_the_pillar_and_tells_how_it_goes(lab: Lab) -> None:
    feedback = lab.read("navigate/feedback", Native)
    goal = await lab.call("navigate/goal", **to(2.5, 0.4, 90))
    ended = await lab.call("navigate/result", timeout_s=40, **goal)
    assert ended == {"status": "succeeded", "result": {"error_code": 0}}
    odometry = await lab.next("odometry", Odometry)
    x_m, y_m, _ = odometry.pose.position_m
    assert math.dist((x_m, y_m), (2.5, 0.4)) < 0.06
    _, _, z, w = odometry.pose.orientation_xyzw
    assert math.degrees(2 * math.atan2(z, w)) == pytest.approx(90, abs=3)
    told = []
    while (received := feedback.subscription.take()) is not None:
        message, _ = CodecRegistry().decode(received.payload, received.encoding)
        assert isinstance(message, Native)
        assert message.value["goal_id"] == goal["goal_id"]
        told.append(message.value["feedback"])
    ways_m = [one["distance_remaining"] for one in told]
    assert len(told) > 15
    assert ways_m[0] > 2.5
    assert ways_m[-1] < 0.1
    assert told[-1]["navigation_time"]["sec"] >= 3
    assert told[0]["current_pose"]["header"]["frame_id"] == "odom"
    assert any(abs(one["current_pose"]["pose"]["position"]["y"]) > 0.1 for one in told)


async def test_navigation_is_cancelled(lab: Lab) -> None:
    goal = await lab.call("navigate/goal", **to(3.0, -1.0))
    await moves(lab)
    assert await lab.call("navigate/cancel", **goal) == {"cancelling": [goal["goal_id"]]}
    assert (await lab.call("navigate/result", **goal))["status"] == "canceled"
    assert (await lab.next("odometry", Odometry)).twist.linear_m_s[0] == 0


@pytest.mark.parametrize("there", [(1.5, 0.3), (3.9, 0.0), (50.0, 0.0)])
async def test_goal_in_a_wall_is_aborted(lab: Lab, there: tuple[float, float]) -> None:
    goal = await lab.call("navigate/goal", **to(*there))
    ended = await lab.call("navigate/result", **goal)
    assert ended == {"status": "aborted", "result": {"error_code": 206}}
    assert await lab.x_m() == 0


async def test_goal_in_a_frame_that_is_not_known_is_refused(lab: Lab) -> None:
    goal = to(1.0, 0.0)
    goal["pose"]["header"] = {"frame_id": "kitchen"}
    with pytest.raises(RemoteError, match="refuses this goal"):
        await lab.call("navigate/goal", **goal)


async def test_a_later_goal_takes_the_place_of_the_earlier(lab: Lab) -> None:
    first = await lab.call("navigate/goal", **to(3.0, -1.0))
    second = await lab.call("navigate/goal", **to(0.5, 0.0))
    assert (await lab.call("navigate/result", **first))["status"] == "aborted"
    assert (await lab.call("navigate/result", timeout_s=20, **second))["status"] == "succeeded"


async def test_who_drives_by_hand_makes_the_navigation_wait(lab: Lab) -> None:
    goal = await lab.call("navigate/goal", **to(1.0, -1.0))
    for _ in range(6):
        await lab.call("drive", linear_m_s=-0.3, for_s=0.5)
        await asyncio.sleep(0.25)
    assert await lab.x_m() < -0.1
    assert (await lab.call("navigate/result", timeout_s=30, **goal))["status"] == "succeeded"
    assert await lab.x_m() == pytest.approx(1.0, abs=0.06)


def to(x: float, y: float, turn_deg: float = 0.0) -> dict[str, Any]:
    half = math.radians(turn_deg / 2)
    orientation = {"z": math.sin(half), "w": math.cos(half)}
    pose = {"position": {"x": x, "y": y}, "orientation": orientation}
    return {"pose": {"header": {"frame_id": "odom"}, "pose": pose}}


async def moves(lab: Lab) -> None:
    async with asyncio.timeout(10):
        while (await lab.next("odometry", Odometry)).twist.linear_m_s[0] < 0.2:
            pass


async def keep_driving(lab: Lab) -> None:
    while True:
        await lab.call("drive", linear_m_s=0.3, for_s=2.0)
        await asyncio.sleep(0.2)


async def test_it_stands_at_the_wall(lab: Lab) -> None:
    for _ in range(5):
        await lab.call("drive", linear_m_s=-0.8, for_s=2.0)
        await asyncio.sleep(1.0)
    diagnostics = await lab.next("diagnostics", Native)
    (status,) = diagnostics.value["status"]
    assert status["message"] == "a wall is in the way"
    assert await lab.x_m() == pytest.approx(-1.75, abs=0.02)
    scan = await lab.next("scan", LaserScan)
    assert scan.ranges_m.tolist()[0] == pytest.approx(0.25, abs=0.02)  # behind it
    assert len(scan.ranges_m.tolist()) == 360


async def test_what_it_may_not_do_is_refused(lab: Lab) -> None:
    limits = await lab.call("limits")
    fastest = limits["joints"][0]["max_linear_m_s"]
    with pytest.raises(RemoteError, match=r"linear_m_s = .* is outside its limits") as caught:
        await lab.call("drive", linear_m_s=fastest + 0.1)
    assert caught.value.kind == "CommandRefusedError"
    assert await lab.x_m() == 0.0


async def test_ros_nodes_see_it_as_they_ask_for(lab: Lab) -> None:
    watch = await lab.peer("watch")
    ((*frames, x, y, w, speed),) = await watch.until("odom")
    assert (frames, x, y, w, speed) == (["odom", "base_link"], 0.0, 0.0, 1.0, 0.0)
    assert await watch.until("tf") == [["odom", "base_link", 0.0]]
    assert await watch.until("joint_states") == [
        [["wheel_left_joint", "wheel_right_joint"], [0.0, 0.0], [0.0, 0.0]]
    ]
    ((frame, count, ahead_m),) = await watch.until("scan")
    assert (frame, count) == ("base_link", 360)
    assert 3.9 <= ahead_m <= 4.0
    began_s = time.monotonic()
    before = len(watch.said("odom")), len(watch.said("scan"))
    await asyncio.sleep(2)
    passed_s = time.monotonic() - began_s
    odometry, scans = (len(watch.said("odom")) - before[0], len(watch.said("scan")) - before[1])
    assert odometry / passed_s == pytest.approx(20, rel=0.15)
    assert scans / passed_s == pytest.approx(10, rel=0.2)


async def test_ros_nodes_drive_it_and_it_stops_when_they_die(lab: Lab) -> None:
    joystick = await lab.peer("drive")
    await asyncio.sleep(1)
    joystick.process.kill()
    x_m = await lab.x_m()
    assert x_m < -0.05
    await asyncio.sleep(1.5)
    odometry = await lab.next("odometry", Odometry)
    assert odometry.twist.linear_m_s[0] == 0
    assert x_m > odometry.pose.position_m[0] > x_m - 0.3


async def test_a_base_that_takes_stamped_velocities_is_driven(tmp_path: Path) -> None:
    routes = tmp_path / "routes.yaml"
    other = """bases:
  - {ros: /stamped, key: other/base, type: geometry_msgs/msg/TwistStamped, max_linear_m_s: 1,
     max_angular_deg_s: 90}
"""
    routes.write_text(ROUTES.read_text().replace("bases:\n", other))
    async with running(routes) as lab:
        with pytest.raises(RemoteError, match="nobody subscribes to /stamped; start the base"):
            await lab.bus.call("other/base/drive", b"", timeout_s=5)
        watch = await lab.peer("watch")

        async def driven() -> bool:
            command = b'{"linear_m_s": 1, "angular_deg_s": 90}'
            try:
                await lab.bus.call("other/base/drive", command, timeout_s=5)
            except RemoteError:
                return False
            return True

        async with asyncio.timeout(10):
            while not await driven():
                await asyncio.sleep(0.05)
        ((sec, linear_m_s, angular_rad_s),) = await watch.until("stamped")
    assert sec == pytest.approx(time.time(), abs=20)
    assert (linear_m_s, angular_rad_s) == (1.0, pytest.approx(math.pi / 2))


async def test_it_is_driven_on_zenoh() -> None:
    locator = f"tcp/127.0.0.1:{free_tcp_port()}"
    with running_router([locator]):
        async with running(driver="rmw_zenoh", router=locator) as lab:
            goal = await lab.call("navigate/goal", **to(0.4, 0.0))
            ended = await lab.call("navigate/result", timeout_s=20, **goal)
            assert ended["status"] == "succeeded"
            await lab.call("drive", linear_m_s=-0.3, for_s=1.0)
            await asyncio.sleep(1.5)
            assert await lab.x_m() < 0.3


async def test_the_adapter_stops_it_when_it_goes(lab: Lab) -> None:
    watch = await lab.peer("watch")
    await watch.until("odom")
    await lab.call("drive", linear_m_s=0.5, for_s=2.0)
    await watch.until("cmd_vel", lambda twist: twist[0] == 0.5)
    lab.service.cancel()
    await watch.until("cmd_vel", lambda twist: twist == [0.0, 0.0])
    assert watch.said("cmd_vel")[-1] == [0.0, 0.0]


async def test_the_adapter_goes_in_time_when_the_base_has_died_under_way(lab: Lab) -> None:
    await lab.call("drive", linear_m_s=0.5, for_s=2.0)
    lab.simulator.kill()
    began_s = time.monotonic()
    lab.service.cancel()
    await asyncio.wait([lab.service], timeout=5)
    assert lab.service.cancelled()
    assert time.monotonic() - began_s < 4  # DDS itself waits for those that do not answer


async def test_a_base_that_went_is_missed_and_driven_again_when_it_is_back(lab: Lab) -> None:
    lab.simulator.terminate()
    await lab.simulator.wait()

    async def refused() -> bool:
        try:
            await lab.call("drive", linear_m_s=0.1)
        except RemoteError as error:
            return "nobody subscribes to /cmd_vel" in str(error)
        except DeadlineError:
            return False
        return False

    async with asyncio.timeout(15):
        while not await refused():
            await asyncio.sleep(0.1)
    lab.simulator = await simulate(lab.domain_id)
    await appears(lab)
    await lab.call("drive", linear_m_s=0.4, for_s=1.0)
    await asyncio.sleep(1.0)
    assert await lab.x_m() > 0.1
