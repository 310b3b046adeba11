"""Which driver: each is imported only if it is chosen, for no library of them is always there."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import import_module
from typing import Final, Literal

from vertebra.errors import ConfigError
from vertebra.ros2.definitions import Types
from vertebra.ros2.driver import Participation, Transport

_NO_ROS: Final = (
    "ROS 2 cannot be imported: {}; source its setup.bash and run the Python that it was built for, "
    "or take the profile rclpy of compose.yaml, or leave the driver at dds, which needs no ROS"
)

DriverName = Literal["dds", "rclpy", "rmw_zenoh"]


@asynccontextmanager
async def open_driver(
    driver: DriverName, part: Participation, types: Types
) -> AsyncIterator[Transport]:
    """Be a node while the block runs.

    Raises:
        ConfigError: The library of this driver is not here.
        TransportError: It cannot start, for example because there is no such interface.
    """
    if driver == "dds":
        from vertebra.ros2.dds.driver import dds_driver  # noqa: PLC0415 - only if chosen

        async with dds_driver(part, types) as transport:
            yield transport
    elif driver == "rclpy":
        try:
            await asyncio.to_thread(import_module, "vertebra.ros2.rclpy.driver")  # many files
        except ImportError as error:
            raise ConfigError(_NO_ROS.format(error)) from error
        from vertebra.ros2.rclpy.driver import rclpy_driver  # noqa: PLC0415 - only if chosen

        async with rclpy_driver(part, types) as transport:
            yield transport
    else:
        from vertebra.ros2.rmw_zenoh.driver import rmw_zenoh_driver  # noqa: PLC0415

        async with rmw_zenoh_driver(part, types) as transport:
            yield transport
