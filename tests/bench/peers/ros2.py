"""ROS 2 nodes in plain `cyclonedds`, the adapter between them and the backbone, and its users.

A stream of three axes is `sensor_msgs/msg/Image` on the topic `/bench/<option>`, of one axis
`sensor_msgs/msg/JointState` with that many joints, the stamp of which is in its efforts.
`endpoint` is the number of the ROS domain, for the backbone's side the locator of its router.
"""

from __future__ import annotations

import asyncio
import math
import struct
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.live.ros2_peer import qos
from tests.live.ros2_types import Header, Image, JointState, Raw, Time
from vertebra.bus import Delivery, ZenohBus, zenoh_bus
from vertebra.codec import CodecRegistry
from vertebra.messages import JointState as Joints
from vertebra.ros2.dds.participant import Input
from vertebra.service import MessagePublisher, MessageReader, run_service
from vertebra_ros2.adapter import serve
from vertebra_ros2.settings import Ros2Settings

from .peer import STAMP, Arrivals, Stream, follow_orders, main, send_paced
from .vertebra import WAIT_S

DEPTH = 1000
IMAGES = 64
"""DDS keeps so many images at most: it asks a reader every few seconds what it has."""
RUN = 1
EFFORTS = struct.Struct("<ddd")


class RawSample(Raw):
    """The library would go over pixels and joints one by one."""

    @classmethod
    def deserialize(cls, payload: bytes) -> RawSample:
        return cls(payload)

    deserialize_key = deserialize


class RawImage(RawSample):
    __idl__ = Image.__idl__
    __idl_typename__ = Image.__idl_typename__


class RawJoints(RawSample):
    __idl__ = JointState.__idl__
    __idl_typename__ = JointState.__idl_typename__


def topic_of(participant: DomainParticipant, stream: Stream) -> Topic[Any]:
    kind = RawImage if len(stream.shape) == 3 else RawJoints
    return Topic(participant, f"rt/bench/{stream.option}", kind)


def reader_of(participant: DomainParticipant, stream: Stream) -> Any:
    settings = qos(depth=depth_of(stream))
    return DataReader(participant, topic_of(participant, stream), qos=settings)


def depth_of(stream: Stream) -> int:
    return IMAGES if len(stream.shape) == 3 else DEPTH


def names(count: int) -> tuple[str, ...]:
    return tuple(f"joint{number}" for number in range(count))


def serialized(sample: Any) -> bytes:
    return bytes(sample.serialize())


def send(stream: Stream) -> None:
    participant = DomainParticipant(int(stream.endpoint))
    topic = topic_of(participant, stream)
    writer = DataWriter(participant, topic, qos=qos(depth=depth_of(stream)))
    header = Header(Time(0, 0), "bench")
    if len(stream.shape) == 3:
        height, width, channels = stream.shape
        pixels = stream.memory()
        empty = serialized(Image(header, height, width, "rgb8", 0, width * channels, []))[:-4]
        payload = bytearray(empty + struct.pack("<I", len(pixels)) + pixels)
        values = memoryview(payload)[-len(pixels) :]
        put: Callable[[Any], None] = lambda _: writer.write(RawImage(bytes(payload)))  # noqa: E731
    else:
        joints = [0.5] * stream.shape[0]
        template = JointState(header, list(names(len(joints))), joints, joints, joints)
        before = serialized(template)[: -EFFORTS.size]
        values = memoryview(bytearray(STAMP.size))

        def put(values: Any) -> None:
            writer.write(RawJoints(before + EFFORTS.pack(*STAMP.unpack(values))))

    follow_orders(lambda order: send_paced(order, values, put))


def receive(stream: Stream) -> None:
    participant = DomainParticipant(int(stream.endpoint))
    reader = reader_of(participant, stream)
    waitset = WaitSet(participant)
    waitset.attach(ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Any))
    ended = threading.Event()
    arrivals = Arrivals(ended.set)
    arrivals.listen()
    is_image, pixels = len(stream.shape) == 3, math.prod(stream.shape)
    while not ended.is_set():
        waitset.wait(duration(milliseconds=200))
        for sample in reader.take(DEPTH):
            if sample.sample_info.valid_data:
                payload: bytes = sample.payload
                if is_image:
                    arrivals.add(memoryview(payload)[-pixels:])
                else:
                    arrivals.add(stamp(EFFORTS.unpack(payload[-EFFORTS.size :])))


def stamp(efforts: Sequence[float]) -> bytes:
    return STAMP.pack(*map(int, efforts))


def publish(stream: Stream) -> None:
    with asyncio.Runner() as runner:
        bus = runner.run(ZenohBus.open(stream.endpoint, timeout_s=WAIT_S))
        publisher = MessagePublisher(bus, CodecRegistry.installed(), stream.key)
        joints = (0.5,) * stream.shape[0]

        def put(values: Any) -> None:
            efforts = joints[:-3] + tuple(map(float, STAMP.unpack(values)))
            publisher.publish(
                Joints(
                    names=names(len(joints)),
                    positions_deg=joints,
                    velocities_deg_s=joints,
                    efforts_nm=efforts,
                )
            )

        values = memoryview(bytearray(STAMP.size))
        follow_orders(lambda order: send_paced(order, values, put))
        runner.run(bus.close())


def subscribe(stream: Stream) -> None:
    asyncio.run(_subscribe(stream))


async def _subscribe(stream: Stream) -> None:
    loop = asyncio.get_running_loop()
    bus = await ZenohBus.open(stream.endpoint, timeout_s=WAIT_S)
    subscription = bus.subscribe(stream.key, Delivery.queue(DEPTH))
    arrivals = Arrivals(lambda: loop.call_soon_threadsafe(subscription.close))
    arrivals.listen()
    async for joints in MessageReader(subscription, CodecRegistry.installed(), Joints):
        arrivals.add(stamp(joints.message.efforts_nm[-3:]))
    await bus.close()


def adapt(stream: Stream) -> None:
    """Run the adapter; `key` is its routes file, `option` the domain.

    It notes how long it has each message that leaves ROS itself: from when its thread takes it from
    DDS until the bus has taken it.
    """
    asyncio.run(_adapt(stream))


async def _adapt(stream: Stream) -> None:
    settings = Ros2Settings(
        router=stream.endpoint, domain_id=int(stream.option), routes=Path(stream.key)
    )
    loop = asyncio.get_running_loop()
    arrivals = Arrivals(lambda: loop.call_soon_threadsafe(service.cancel))
    take, put = Input.take, zenoh_bus._Publisher.put
    began_ns = 0

    def timed_take(one: Input) -> bool:
        nonlocal began_ns
        now_ns = time.monotonic_ns()
        if came := take(one):
            began_ns = now_ns
        return came

    def timed_put(publisher: Any, *arguments: Any, **options: Any) -> None:
        put(publisher, *arguments, **options)
        if publisher.key.startswith("bench/"):
            arrivals.add(STAMP.pack(began_ns, RUN, 0))

    with (
        mock.patch.object(Input, "take", timed_take),
        mock.patch.object(zenoh_bus._Publisher, "put", timed_put),
    ):
        service = asyncio.create_task(run_service("ros2", settings, serve))
        arrivals.listen()
        await asyncio.wait([service])


if __name__ == "__main__":
    main(
        {
            "send": send,
            "receive": receive,
            "publish": publish,
            "subscribe": subscribe,
            "adapt": adapt,
        }
    )
