"""The simulated robot on real YARP ports, with the built-in name server."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
import time
from array import array
from collections.abc import AsyncIterator
from dataclasses import dataclass

import numpy as np
import pytest

from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.messages import Status
from vertebra.service import run_service
from vertebra.testing.bus_suite import eventually
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import (
    Incoming,
    NameClient,
    NameServer,
    Port,
    Reader,
    RpcClient,
    Sender,
    Value,
    Vocab,
    encode,
    from_text,
)
from vertebra.yarp.objects import Image, JointData, Pair, SensorData, Sound, Stamp, Vector
from vertebra_simulator.adapter import serve
from vertebra_simulator.settings import SimulatorSettings

pytestmark = pytest.mark.live

STATUS_KEY = "@vertebra/services/simulator/1/status"
PORTS = {
    "/vizzy/camera/left",
    "/vizzy/camera/left/rpc",
    "/vizzy/face/emotions/in",
    "/vizzy/face/image:o",
    "/vizzy/gaze/angles:i",
    "/vizzy/gaze/angles:o",
    "/vizzy/gaze/mono:i",
    "/vizzy/gaze/rpc",
    "/vizzy/gaze/x:o",
    "/vizzy/gaze/xd:i",
    "/vizzy/head/command:i",
    "/vizzy/head/inertials/measures:o",
    "/vizzy/head/inertials/rpc:o",
    "/vizzy/head/rpc:i",
    "/vizzy/head/state:o",
    "/vizzy/head/stateExt:o",
    "/vizzy/imu",
    "/vizzy/microphone/audio:o",
    "/vizzy/speaker/audio:i",
}


@dataclass
class Lab:
    """A running simulator and the name server it is registered with."""

    names: NameClient
    tcp_port: int
    bus: MemoryBus
    service: asyncio.Task[None]

    async def metric(self, name: str) -> float:
        reply = await self.bus.call("@vertebra/services/simulator/1/metrics", timeout_s=5)
        lines = dict(line.split() for line in reply.payload.decode().splitlines() if line[0] != "#")
        return float(lines[f"vertebra_simulator_{name}"])

    async def status(self) -> Status:
        async with self.bus.subscribe(STATUS_KEY, Delivery.latest()) as statuses:
            sample = await asyncio.wait_for(anext(statuses), 5)
        message, _ = CodecRegistry.installed().decode(sample.payload, sample.encoding)
        assert isinstance(message, Status)
        return message

    async def registered(self) -> None:
        async with asyncio.timeout(10):
            while {contact.name for contact in await self.names.list_ports("/vizzy")} != PORTS:
                await asyncio.sleep(0.02)


class Ear:
    """Keeps what a reader gets."""

    def __init__(self) -> None:
        self.heard: list[Incoming] = []

    def __call__(self, incoming: Incoming) -> None:
        self.heard.append(incoming)

    async def hear(self, count: int) -> list[Incoming]:
        target = len(self.heard) + count
        await eventually(lambda: len(self.heard) >= target)
        return self.heard[-count:]


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    tcp_port = free_tcp_port()
    network = MemoryNetwork()
    settings = SimulatorSettings(name_server=f"127.0.0.1:{tcp_port}")
    service = asyncio.create_task(run_service("simulator", settings, serve, bus=MemoryBus(network)))
    bus = MemoryBus(network)
    yield Lab(NameClient("127.0.0.1", tcp_port), tcp_port, bus, service)
    service.cancel()
    await asyncio.wait([service], timeout=5)
    await bus.close()
    assert service.cancelled()


@pytest.fixture
async def named(lab: Lab) -> AsyncIterator[Lab]:
    async with await NameServer.start(tcp_port=lab.tcp_port):
        await lab.registered()
        yield lab


async def ask(client: RpcClient, text: str) -> list[Value]:
    return await client.call(from_text(text), timeout_s=2)


async def test_rpc_moves_the_head_and_reads_where_it_is(named: Lab) -> None:
    async with await RpcClient.connect("/vizzy/head/rpc:i", named.names) as client:
        assert await ask(client, "[get] [prot]") == [Vocab("prot"), 1, 9, 0, Vocab("ok")]
        assert await ask(client, "[set] [vel] 2 60") == [Vocab("ok")]
        assert await ask(client, "[set] [pos] 2 25") == [Vocab("ok")]
        began_s = time.monotonic()
        async with asyncio.timeout(5):
            while (await ask(client, "[get] [don] 2"))[2] != 1:
                await asyncio.sleep(0.01)
        # 60 deg/s, 200 deg/s2: 0.3 s up, 0.3 s down, 18 degrees; the other 7 take 0.12 s
        assert time.monotonic() - began_s == pytest.approx(0.72, abs=0.2)
        assert (await ask(client, "[get] [enc] 2"))[2] == 25
        assert await ask(client, "[nonsense] 1") == [Vocab("fail")]
    async with await RpcClient.connect("/vizzy/camera/left/rpc", named.names) as client:
        assert (await ask(client, "[visr] [get] [w]"))[-1] == 320
        assert (await ask(client, "[visr] [get] [h]"))[-1] == 240


async def test_images_stream_with_rising_stamps_to_two_readers_and_only_while_wanted(
    named: Lab,
) -> None:
    await asyncio.sleep(0.2)
    assert await named.metric("images_total") == 0
    first, second = Ear(), Ear()
    reader = await Reader.dial(
        "/vizzy/camera/left", named.names, on_data=first, reader_name="/test/first"
    )
    other = await Reader.dial(
        "/vizzy/camera/left", named.names, on_data=second, reader_name="/test/second", carrier="tcp"
    )
    images = await first.hear(20)
    await second.hear(20)
    await other.close()
    await first.hear(5)
    image = Image.decode(images[-1].payload)
    assert (image.pixel_code, image.width, image.height) == ("rgb", 320, 240)
    stamps = [Stamp.from_envelope(incoming.envelope) for incoming in images]
    counts = [stamp.count for stamp in stamps]
    assert counts == sorted(set(counts))
    times_s = [stamp.time_s for stamp in stamps]
    assert times_s == sorted(times_s)
    assert (times_s[-1] - times_s[0]) / (counts[-1] - counts[0]) == pytest.approx(1 / 30, rel=0.1)
    assert abs(times_s[-1] - time.time()) < 1
    await reader.close()
    async with asyncio.timeout(5):
        while await named.metric("readers") != 0:
            await asyncio.sleep(0.02)
    before = await named.metric("images_total")
    await asyncio.sleep(0.3)
    assert await named.metric("images_total") == before


async def test_the_view_shifts_as_the_head_turns(named: Lab) -> None:
    ear = Ear()
    reader = await Reader.dial(
        "/vizzy/camera/left", named.names, on_data=ear, reader_name="/test/eye"
    )
    (before,) = await ear.hear(1)
    async with await RpcClient.connect("/vizzy/head/rpc:i", named.names) as client:
        await ask(client, "[set] [pos] 2 30")
        await ear.hear(60)
    await reader.close()
    pictures = [
        np.frombuffer(Image.decode(incoming.payload).pixels, np.uint8).astype(int)
        for incoming in (before, ear.heard[-1])
    ]
    assert np.abs(pictures[0] - pictures[1]).mean() > 15


async def test_state_follows_streamed_commands(named: Lab) -> None:
    state, extended, imu = Ear(), Ear(), Ear()
    readers = [
        await Reader.dial(f"/vizzy/{name}", named.names, on_data=ear, reader_name=f"/test/{name}")
        for name, ear in (("head/state:o", state), ("head/stateExt:o", extended), ("imu", imu))
    ]
    async with (
        await RpcClient.connect("/vizzy/head/rpc:i", named.names) as client,
        await Port.open("/test/command:o", named.names, delivery="queue") as port,
    ):
        await ask(client, "[set] [icmd] [cmod] 2 [posd]")
        await port.connect("/vizzy/head/command:i")
        port.write(b"no pair")
        port.write(Pair([Vocab("vmo"), 2], Vector.of([1.0])).encode())
        port.write(Pair([Vocab("dpo"), 2], Vector.of([-15.0])).encode())
        await eventually(
            lambda: bool(state.heard) and Vector.decode(state.heard[-1].payload).values[2] == -15
        )
        await eventually(
            lambda: JointData.decode(extended.heard[-1].payload).joint_position.values[2] == -15
        )
    assert await named.metric("refused") == 2
    assert JointData.decode(extended.heard[-1].payload).control_mode.words[2] == Vocab("posd")
    felt = Vector.decode((await imu.hear(1))[0].payload).values
    assert len(felt) == 12
    assert felt[2] == pytest.approx(-15)
    counts = [Stamp.from_envelope(incoming.envelope).count for incoming in state.heard]
    assert counts == sorted(set(counts))
    for reader in readers:
        await reader.close()


READER = """
import asyncio, sys
from vertebra.yarp import NameClient, Reader
async def main():
    names = NameClient("127.0.0.1", int(sys.argv[1]))
    said = []
    def say(incoming):
        if not said:
            said.append(print("reading", flush=True))
    await Reader.dial("/vizzy/camera/left", names, on_data=say, reader_name="/test/killed")
    await asyncio.sleep(60)
asyncio.run(main())
"""


async def test_a_killed_and_a_stuck_reader_disturb_nobody(named: Lab) -> None:
    killed = await asyncio.create_subprocess_exec(
        sys.executable, "-c", READER, str(named.tcp_port), stdout=asyncio.subprocess.PIPE
    )
    assert killed.stdout is not None
    assert await asyncio.wait_for(killed.stdout.readline(), 10) == b"reading\n"
    ear = Ear()
    reader = await Reader.dial(
        "/vizzy/camera/left", named.names, on_data=ear, reader_name="/test/well"
    )
    os.kill(killed.pid, signal.SIGSTOP)  # its sockets fill up
    async with asyncio.timeout(20):
        while await named.metric("dropped") == 0:
            await ear.hear(5)
    os.kill(killed.pid, signal.SIGKILL)
    await killed.wait()
    await ear.hear(10)
    assert await named.metric("readers") == 1
    await reader.close()


async def test_silent_and_rubbish_peers_do_not_matter(named: Lab) -> None:
    contact = await named.names.query("/vizzy/head/rpc:i")
    assert contact is not None
    with (
        socket.create_connection((contact.host, contact.tcp_port)),
        socket.create_connection((contact.host, contact.tcp_port)) as rubbish,
    ):
        rubbish.sendall(bytes(range(256)))
        async with await RpcClient.connect("/vizzy/head/rpc:i", named.names) as client:
            assert (await ask(client, "[get] [axes]"))[2] == 6


async def test_it_waits_for_a_name_server_and_survives_its_restart(lab: Lab) -> None:
    async with asyncio.timeout(5):
        while "name server" not in (status := await lab.status()).text:
            pass
    assert status.level == "error"
    assert str(lab.tcp_port) in status.text
    ear = Ear()
    async with await NameServer.start(tcp_port=lab.tcp_port):
        await lab.registered()
        reader = await Reader.dial(
            "/vizzy/head/state:o", lab.names, on_data=ear, reader_name="/test/patient"
        )
        await ear.hear(2)
    await ear.hear(20)  # streams go on without it
    async with await NameServer.start(tcp_port=lab.tcp_port):
        await lab.registered()
        async with await RpcClient.connect("/vizzy/head/rpc:i", lab.names) as client:
            assert (await ask(client, "[get] [axes]"))[2] == 6
    await reader.close()
    assert "name server" not in (await lab.status()).text


async def test_gaze_turns_head_and_eyes(named: Lab) -> None:
    angles = Ear()
    reader = await Reader.dial(
        "/vizzy/gaze/angles:o", named.names, on_data=angles, reader_name="/test/angles"
    )
    sender = await Sender.dial("/vizzy/gaze/angles:i", named.names, sender_name="/test/gaze")
    sender.write(encode(["abs", -20.0, 10.0, 5.0]))
    await eventually(
        lambda: (
            bool(angles.heard)
            and np.allclose(Vector.decode(angles.heard[-1].payload).values, [-20, 10, 5], atol=0.2)
        )
    )
    sender.write(encode(["sideways", 1.0, 1.0, 1.0]))
    async with asyncio.timeout(5):
        while await named.metric("refused") != 1:
            await asyncio.sleep(0.02)
    async with await RpcClient.connect("/vizzy/gaze/rpc", named.names) as client:
        async with asyncio.timeout(5):
            while await ask(client, "[get] [done]") != [Vocab("ack"), 1]:
                await asyncio.sleep(0.02)
        assert await ask(client, "[stop]") == [Vocab("ack")]
        assert await ask(client, "[nonsense]") == [Vocab("nack")]
    await sender.close()
    await reader.close()


async def test_microphone_hears_the_speaker_and_the_face_shows_what_it_is_told(named: Lab) -> None:
    heard, seen = Ear(), Ear()
    readers = [
        await Reader.dial(f"/vizzy/{name}", named.names, on_data=ear, reader_name=f"/test/{name}")
        for name, ear in (("microphone/audio:o", heard), ("face/image:o", seen))
    ]
    await heard.hear(1)
    (neutral,) = await seen.hear(1)
    speaker = await Sender.dial(
        "/vizzy/speaker/audio:i", named.names, sender_name="/test/say", carrier="tcp"
    )
    tone = array("h", [1000, -1000] * 800)
    speaker.write(Sound(8000, 1, tone).encode())
    assert await speaker.wait_taken()
    await eventually(lambda: any(any(Sound.decode(i.payload).samples) for i in heard.heard))
    loud = [Sound.decode(i.payload) for i in heard.heard]
    assert {sound.frequency_hz for sound in loud} == {16000}
    await heard.hear(2)
    assert sum(sum(map(abs, Sound.decode(i.payload).samples)) for i in heard.heard) == 3_200_000
    async with await RpcClient.connect("/vizzy/face/emotions/in", named.names) as client:
        assert await ask(client, "set all hap") == [Vocab("ok")]
        assert await ask(client, "set all xyz") == [Vocab("fail")]
        assert await ask(client, "get all") == [Vocab("fail")]
    await seen.hear(3)
    assert bytes(seen.heard[-1].payload) != bytes(neutral.payload)
    await speaker.close()
    for reader in readers:
        await reader.close()


async def test_inertials_are_those_of_a_multi_analog_sensors_server(named: Lab) -> None:
    ear = Ear()
    reader = await Reader.dial(
        "/vizzy/head/inertials/measures:o", named.names, on_data=ear, reader_name="/test/imu"
    )
    (incoming,) = await ear.hear(1)
    data = SensorData.decode(incoming.payload)
    assert data.linear_accelerometers[0].values[2] == pytest.approx(9.81)
    assert data.magnetometers[0].values[0] == pytest.approx(24e-6)
    assert (len(data.gyroscopes), len(data.orientations), data.skin_patches) == (1, 1, ())
    async with await RpcClient.connect("/vizzy/head/inertials/rpc:o", named.names) as client:
        told = await ask(client, "getMetadata")
    assert len(told) == 12
    assert told[0] == [["head_imu", "head", ""]]
    await reader.close()
