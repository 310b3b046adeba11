"""A control board of YARP 4.0 through the adapter: found by its dialect, told in its words."""

from __future__ import annotations

import asyncio
import contextlib
import json
from array import array
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from vertebra.bus import MemoryBus, MemoryNetwork
from vertebra.errors import RemoteError
from vertebra.service import run_service
from vertebra.testing.ports import free_tcp_port
from vertebra.yarp import Dialect, Incoming, NameClient, Port, Value, Vocab, to_text
from vertebra.yarp.objects import JointData, JointModes, JointValues, Pair
from vertebra_yarp.adapter import serve
from vertebra_yarp.settings import YarpSettings

pytestmark = pytest.mark.live

OK = Vocab("ok")
V4 = Dialect.V4


class Board:
    """Two joints that are where they are told to be at once; it understands `ControlBoardMsgs`."""

    def __init__(self) -> None:
        self.positions = [0.0, 0.0]
        self.modes = [Vocab("pos"), Vocab("pos")]
        self.streamed: list[str] = []
        self.asked: list[str] = []
        self.tells_arrival = True

    async def answer(self, incoming: Incoming) -> list[Value]:
        method, *arguments = incoming.bottle()
        self.asked.append(str(method))
        match [str(method), *arguments]:
            case ["getAxesRPC"]:
                return [[OK], 2]
            case ["getAxisNameRPC", int() as joint]:
                return [[OK], ("pan", "tilt")[joint]]
            case ["getPosLimitsRPC", int()]:
                return [[OK], -45.0, 45.0]
            case ["getVelLimitsRPC", int()]:
                return [[OK], 0.0, 60.0]
            case ["getEncoderAllRPC"]:
                return [[OK], [*self.positions]]
            case ["checkMotionDoneGroupRPC", list()]:
                return [[OK], OK if self.tells_arrival else Vocab("fail")]
            case ["positionMoveGroupRPC", list() as joints, list() as targets]:
                for joint, target in zip(joints, targets, strict=True):
                    self.positions[joint] = target
                return [OK]
            case ["setControlModeGroupRPC", list() as joints, list() as codes]:
                for joint, code in zip(joints, codes, strict=True):
                    self.modes[joint] = Vocab.from_code(code)
                return [OK]
            case ["stopGroupRPC", list()] | ["stopAllRPC"]:
                return [OK]
        return [Vocab("err2")]

    def command(self, incoming: Incoming) -> None:
        assert incoming.dialect is V4
        pair = Pair.decode(incoming.payload, V4)
        self.streamed.append(f"{to_text(pair.head)} : {[*pair.body.values]}")

    async def stream(self, port: Port) -> None:
        while True:
            measured = JointValues(array("d", self.positions), ok=True)
            modes = JointModes((*self.modes,), ok=True)
            port.write(
                JointData(joint_position=measured, joint_velocity=measured, control_mode=modes)
            )
            await asyncio.sleep(0.02)


@pytest.fixture
async def lab(tmp_path: Path) -> AsyncIterator[tuple[Board, MemoryBus]]:
    routes = tmp_path / "routes.yaml"
    routes.write_text("control_boards:\n  - {yarp: /four/head, key: four/head}\n")
    network = MemoryNetwork()
    bus = MemoryBus(network)
    tcp_port = free_tcp_port()
    settings = YarpSettings(name_server_bind=f"127.0.0.1:{tcp_port}", routes=routes)
    adapter = asyncio.create_task(run_service("yarp", settings, serve, bus=MemoryBus(network)))
    async with bus.presence("@vertebra/services/yarp/1/alive") as presence:
        await asyncio.wait_for(anext(presence), 5)
    names = NameClient("127.0.0.1", tcp_port)
    board = Board()
    async with contextlib.AsyncExitStack() as stack:
        name = "/four/head"
        commands = await Port.open(f"{name}/command:i", names, dialect=V4, on_data=board.command)
        states = await Port.open(f"{name}/stateExt:o", names, dialect=V4)
        rpc = await Port.open(f"{name}/nws/rpc:i", names, dialect=V4, on_call=board.answer)
        for port in (commands, states, rpc):
            await stack.enter_async_context(port)
        streaming = asyncio.create_task(board.stream(states))
        async with bus.presence("@vertebra/parts/four/head") as presence:
            await asyncio.wait_for(anext(presence), 10)
        yield board, bus
        streaming.cancel()
        adapter.cancel()
        await asyncio.wait([streaming, adapter], timeout=5)
    await bus.close()


async def call(bus: MemoryBus, name: str, body: Any = None) -> Any:
    payload = b"" if body is None else json.dumps(body).encode()
    reply = await bus.call(f"four/head/{name}", payload, encoding="application/json", timeout_s=5)
    return json.loads(reply.payload)


async def test_board_of_yarp_4_is_commanded_in_thrift(lab: tuple[Board, MemoryBus]) -> None:
    board, bus = lab
    limits = await call(bus, "limits")
    assert [joint["name"] for joint in limits["joints"]] == ["pan", "tilt"]
    assert limits["joints"][0]["max_velocity_deg_s"] == 60.0
    done = await call(bus, "move", {"positions_deg": {"tilt": 12.5}})
    assert done["reached"]
    assert done["positions_deg"] == {"pan": 0.0, "tilt": 12.5}
    assert (await call(bus, "modes"))["modes"] == {"pan": "position", "tilt": "position"}
    await call(bus, "direct", {"positions_deg": {"pan": 3.0}})
    assert board.modes == ["posd", "pos"]
    await call(bus, "velocity", {"velocities_deg_s": {"tilt": -5.0}, "for_s": 0.1})
    await asyncio.sleep(0.3)
    assert board.streamed[0] == "[ipod] [dpog] 1 (0) : [3.0]"
    assert set(board.streamed[1:]) == {"[ivel] [vmog] 1 (1) : [-5.0]"}
    assert board.asked[-1] == "stopGroupRPC", "the deadman"
    with pytest.raises(RemoteError, match=r"answered \[err2\] to getTrajSpeedsAllRPC"):
        await call(bus, "speeds")


async def test_a_board_that_never_tells_that_it_arrived_is_believed_its_positions(
    lab: tuple[Board, MemoryBus],
) -> None:
    board, bus = lab
    board.tells_arrival = False  # as fakeMotionControl of YARP 3.12
    done = await call(bus, "move", {"positions_deg": {"tilt": 12.5}})
    assert done["reached"]
    assert done["positions_deg"] == {"pan": 0.0, "tilt": 12.5}
