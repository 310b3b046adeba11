"""Wiring: the base as a ROS 2 node, fed in real time."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any, Final

from vertebra.errors import CommandRefusedError
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation, Transport, Writer
from vertebra.ros2.drivers import open_driver
from vertebra.ros2.qos import Qos
from vertebra.service import Context
from vertebra_simulator import records
from vertebra_simulator.base import COMMAND_HOLDS_S, Base
from vertebra_simulator.floorplan import ROOM
from vertebra_simulator.journeys import Journeys
from vertebra_simulator.settings import SimulatorSettings
from vertebra_simulator.ticks import ticks

log = logging.getLogger(__name__)

MOVE_RATE_HZ: Final = 20.0
SCAN_RATE_HZ: Final = 10.0
DIAGNOSTICS_RATE_HZ: Final = 1.0

CMD_VEL: Final = "/cmd_vel"
_TWIST: Final = "geometry_msgs/msg/Twist"
_SENSOR: Final = Qos(reliability="best_effort", depth=5)
TOPICS: Final = {
    "/odom": ("nav_msgs/msg/Odometry", Qos()),
    "/tf": ("tf2_msgs/msg/TFMessage", Qos(depth=100)),
    "/joint_states": ("sensor_msgs/msg/JointState", Qos()),
    "/scan": ("sensor_msgs/msg/LaserScan", _SENSOR),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", Qos()),
}


async def serve_wheels(context: Context[SimulatorSettings]) -> None:
    """Be the base of the robot until cancelled."""
    settings = context.settings
    types = await asyncio.to_thread(Types.standard)
    part = Participation(
        domain_id=settings.ros2_domain_id,
        node=f"{records.token_of(settings.robot)}_base",
        interface="" if settings.ros2_interface == "auto" else settings.ros2_interface,
        peers=settings.ros2_peers,
        router=settings.ros2_zenoh_router or settings.router,
    )
    async with open_driver(settings.ros2_driver, part, types) as transport:
        wheels = Wheels(context, transport, Cdr(types))
        log.info("the base is the ROS 2 node /%s in domain %d", part.node, part.domain_id)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(_end_with(transport))
            tasks.create_task(wheels.move(), name="wheels")
            tasks.create_task(wheels.tell_scan(), name="scan")
            tasks.create_task(wheels.tell_diagnostics(), name="diagnostics")


async def _end_with(transport: Transport) -> None:
    await transport.failed


class Wheels:
    """The base, what it is told, and what it tells."""

    def __init__(self, context: Context[SimulatorSettings], transport: Transport, cdr: Cdr) -> None:
        self._robot = context.settings.robot
        self._graph = transport.graph
        self._cdr = cdr
        self._began_s = time.monotonic()
        self._base = Base(ROOM)
        self._by_hand_until_s = 0.0
        self._skipped = context.counter("simulator_wheel_ticks_skipped", "Times that were too late")
        self._refused = context.counter("simulator_velocities_refused", "Velocities of no number")
        self._writers: dict[str, Writer] = {
            name: transport.writer(name, *offered) for name, offered in TOPICS.items()
        }
        transport.reader(CMD_VEL, _TWIST, Qos(depth=1), self._drive)
        self._journeys = Journeys(transport, cdr, self._base, ROOM)

    def _drive(self, payload: bytes, _: int) -> None:
        """Drive as somebody says; while that holds, the navigation waits."""
        self._live()
        self._by_hand_until_s = self._base.time_s + COMMAND_HOLDS_S
        try:
            self._base.drive(records.read_velocity(self._cdr.decode(payload, _TWIST)))
        except CommandRefusedError as error:
            self._refused.inc()
            log.warning("refused on %s: %s", CMD_VEL, error)

    async def move(self) -> None:
        """Let the base move, and tell where it is."""
        async for _ in ticks(MOVE_RATE_HZ, self._skipped.inc):
            self._live()
            self._journeys.go_on(by_hand=self._base.time_s < self._by_hand_until_s)
            now_ns = time.time_ns()
            self._tell("/odom", records.odometry(self._base, now_ns))
            self._tell("/tf", records.transform(self._base, now_ns))
            self._tell("/joint_states", records.joints(self._base, now_ns))

    async def tell_scan(self) -> None:
        """Tell what the laser sees, as long as somebody looks."""
        async for _ in ticks(SCAN_RATE_HZ, self._skipped.inc):
            if self._graph.readers("/scan"):
                self._live()
                self._tell("/scan", records.scan(self._base, ROOM, SCAN_RATE_HZ, time.time_ns()))

    async def tell_diagnostics(self) -> None:
        """Tell how the base is doing."""
        async for _ in ticks(DIAGNOSTICS_RATE_HZ, self._skipped.inc):
            now_ns = time.time_ns()
            told = records.diagnostics(self._base, self._robot, self._journeys.doing, now_ns)
            self._tell("/diagnostics", told)

    def _tell(self, topic: str, record: Any) -> None:
        type_name, _ = TOPICS[topic]
        self._writers[topic].write(self._cdr.encode(record, type_name))

    def _live(self) -> None:
        """Let the base move on to now."""
        self._base.advance_to(time.monotonic() - self._began_s)
