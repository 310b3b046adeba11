"""The frame of a service on a bus in memory: presence, status, info, metrics, heartbeat, stop."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr
from pydantic_settings import SettingsConfigDict

from vertebra import __version__, heartbeat
from vertebra.bus import Delivery, MemoryBus, MemoryNetwork
from vertebra.codec import CodecRegistry
from vertebra.errors import ConfigError, NotConnectedError, TransportError
from vertebra.messages import Status, Text
from vertebra.service import Context, MessageReader, ServiceSettings, run_service, service_key

TIMEOUT_S = 5.0


class ProbeSettings(ServiceSettings):
    """What these tests need."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_PROBE_")

    token: SecretStr = SecretStr("correct horse")


@pytest.fixture(autouse=True)
def beats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", str(tmp_path))
    return tmp_path / "vertebra-probe.heartbeat"


class Probe:
    """A service under test, with a way in and a member of its network beside it."""

    def __init__(self) -> None:
        self.network = MemoryNetwork()
        self.here = MemoryBus(self.network)
        self.context: asyncio.Future[Context[ProbeSettings]] = asyncio.Future()
        self.started: Callable[[Context[ProbeSettings]], None] = lambda context: context.ready()

    async def serve(self, context: Context[ProbeSettings]) -> None:
        self.started(context)
        self.context.set_result(context)

    async def statuses(self) -> AsyncIterator[Status]:
        key = service_key("probe", "1", "status")
        async with self.here.subscribe(key, Delivery.queue(16)) as samples:
            async for received in MessageReader(samples, CodecRegistry(), Status):
                yield received.message

    async def ask(self, leaf: str) -> bytes:
        reply = await self.here.call(service_key("probe", "1", leaf), timeout_s=TIMEOUT_S)
        return reply.payload

    def run(self) -> asyncio.Task[None]:
        bus = MemoryBus(self.network)
        return asyncio.create_task(run_service("probe", ProbeSettings(), self.serve, bus=bus))


@pytest.fixture
async def probe() -> AsyncIterator[Probe]:
    probe = Probe()
    yield probe
    await probe.here.close()


@asynccontextmanager
async def running(probe: Probe) -> AsyncIterator[Context[ProbeSettings]]:
    task = probe.run()
    async with asyncio.timeout(TIMEOUT_S):
        yield await probe.context
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def until(statuses: AsyncIterator[Status], level: str) -> Status:
    async with asyncio.timeout(TIMEOUT_S):
        async for status in statuses:
            if status.level == level:
                return status
    raise AssertionError(level)


async def test_a_service_is_present_while_it_runs(probe: Probe) -> None:
    async with probe.here.presence("@vertebra/services/*/*/alive") as presence:
        async with running(probe), asyncio.timeout(TIMEOUT_S):
            event = await anext(presence)
            assert (event.key, event.present) == ("@vertebra/services/probe/1/alive", True)
        event = await anext(presence)
        assert not event.present


async def test_a_service_that_is_ready_says_so_at_once(
    probe: Probe, beats: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vertebra.service.run._BEAT_EVERY_S", 60.0)
    statuses = probe.statuses()
    asking = asyncio.create_task(until(statuses, "ok"))
    await asyncio.sleep(0)
    async with running(probe):
        status = await asking
        assert (status.text, status.values["shared_memory_misses"]) == ("", 0)
        assert beats.read_text() == "ok"
    await statuses.aclose()  # type: ignore[attr-defined]


async def test_a_service_that_is_not_ready_is_not_well(probe: Probe, beats: Path) -> None:
    probe.started = lambda _: None
    statuses = probe.statuses()
    asking = asyncio.create_task(until(statuses, "error"))
    await asyncio.sleep(0)
    async with running(probe):
        assert (await asking).text == "start: not ready yet"
        assert beats.read_text() == "start: not ready yet"
    await statuses.aclose()  # type: ignore[attr-defined]


async def test_a_report_shows_until_it_is_well_again(
    probe: Probe, beats: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "vertebra")
    async with running(probe) as context:
        assert context.status().level == "ok"
        context.report("camera", "warning", "slow")
        assert context.status().level == "warning"
        for _ in range(3):
            context.report("left", "error", "unplugged")
        status = context.status()
        assert (status.level, status.text) == ("error", "camera: slow; left: unplugged")
        context.report("left", "ok")
        context.report("left", "ok")
        context.report("camera", "ok")
        assert context.status() == Status(level="ok", values=context.status().values)
    told = [(record.levelname, record.getMessage()) for record in caplog.records]
    assert [text for text in told if "left" in text[1]] == [
        ("ERROR", "left: unplugged"),
        ("INFO", "left is well again"),
    ]


async def test_an_error_reaches_status_and_heartbeat_a_warning_only_the_status(
    probe: Probe, beats: Path
) -> None:
    statuses = probe.statuses()
    async with running(probe) as context:
        context.report("left", "error", "unplugged")
        await until(statuses, "error")
        assert beats.read_text() == "left: unplugged"
        context.report("left", "warning", "slow")
        await until(statuses, "warning")
        await asyncio.to_thread(_wait_for_good_heartbeat, beats)
    await statuses.aclose()  # type: ignore[attr-defined]


def _wait_for_good_heartbeat(path: Path) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while heartbeat.check(path):
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


async def test_info_tells_what_it_is_and_no_secrets(probe: Probe) -> None:
    probe.started = lambda context: context.routes.update({"/a": "robot/a"})
    async with running(probe):
        text = (await probe.ask("info")).decode()
        info: dict[str, Any] = json.loads(text)
        assert (info["service"], info["instance"], info["version"]) == ("probe", "1", __version__)
        assert (info["routes"], info["pid"]) == ({"/a": "robot/a"}, os.getpid())
        assert info["settings"]["router"] == "tcp/127.0.0.1:7447"
        assert "horse" not in text


async def test_metrics_are_those_of_the_service(probe: Probe) -> None:
    async with running(probe) as context:
        context.counter("probe_things", "Things that were done").inc(3)
        context.gauge("probe_depth", "How deep it is", lambda: 7.5)
        context.gauge("probe_set", "What was set").set(2)
        text = (await probe.ask("metrics")).decode()
        assert "vertebra_probe_things_total 3.0" in text
        assert "vertebra_probe_depth 7.5" in text
        values = context.status().values
        assert (values["probe_things"], values["probe_depth"], values["probe_set"]) == (3, 7.5, 2)


async def test_messages_carry_the_service_as_origin_and_are_numbered(probe: Probe) -> None:
    async with (
        probe.here.subscribe("robot/words", Delivery.queue(4)) as samples,
        running(probe) as context,
    ):
        publisher = context.publisher("robot/words")
        publisher.publish(Text(text="one"), captured_ns=5)
        publisher.publish(Text(text="two"))
        reader = aiter(MessageReader(samples, CodecRegistry(), Text))
        first, second = await anext(reader), await anext(reader)
    assert (first.key, first.message.text, first.header.captured_ns) == ("robot/words", "one", 5)
    assert [each.header.sequence for each in (first, second)] == [0, 1]
    assert {each.header.origin for each in (first, second)} == {"probe"}
    assert abs(time.time_ns() - second.header.captured_ns) < 5e9


async def test_a_task_that_fails_stops_the_service_with_its_error(probe: Probe) -> None:
    async def fail() -> None:
        raise TransportError("the robot is on fire")

    probe.started = lambda context: context.ready()
    task = probe.run()
    context = await probe.context
    sibling = context.tasks.create_task(asyncio.sleep(60))
    context.tasks.create_task(fail())
    with pytest.raises(TransportError, match="on fire"):
        await asyncio.wait_for(task, TIMEOUT_S)
    assert sibling.cancelled()
    with pytest.raises(NotConnectedError):
        context.bus.subscribe("a", Delivery.latest())


async def test_a_service_that_cannot_start_ends_with_its_error(probe: Probe) -> None:
    def refuse(_: Context[ProbeSettings]) -> None:
        raise ConfigError("no such route")

    probe.started = refuse
    with pytest.raises(ConfigError, match="no such route"):
        await asyncio.wait_for(probe.run(), TIMEOUT_S)
    assert probe.network.present == []


async def test_a_heartbeat_that_cannot_be_written_stops_the_service(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VERTEBRA_HEARTBEAT_DIR", "/nowhere")
    with pytest.raises(ConfigError, match="set VERTEBRA_HEARTBEAT_DIR"):
        await asyncio.wait_for(probe.run(), TIMEOUT_S)


MODULE = """
import asyncio, sys
from pydantic_settings import SettingsConfigDict
from vertebra.service import ServiceSettings, main
class ProbeSettings(ServiceSettings):
    "What this test needs."
    model_config = SettingsConfigDict(env_prefix="VERTEBRA_PROBE_")
    rate_hz: float = 30.0
async def serve(context):
    context.ready()
sys.exit(main("probe", ProbeSettings, serve))
"""


def run_main(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("VERTEBRA_")}
    return subprocess.run(
        [sys.executable, "-c", MODULE, *arguments],
        env=kept | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_check_prints_the_settings_and_ends() -> None:
    done = run_main("--check", VERTEBRA_PROBE_RATE_HZ="5")
    assert (done.returncode, "rate_hz: 5.0\n" in done.stdout, done.stderr) == (0, True, "")


def test_a_bad_setting_is_one_line_and_status_2() -> None:
    done = run_main(VERTEBRA_PROBE_RATE_HZ="fast")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("probe: VERTEBRA_PROBE_RATE_HZ = 'fast': ")
    assert done.stderr.count("\n") == 1


def test_a_locator_that_is_none_is_status_2(tmp_path: Path) -> None:
    done = run_main(VERTEBRA_ROUTER="7447", VERTEBRA_HEARTBEAT_DIR=str(tmp_path))
    assert done.returncode == 2
    assert "'7447' is no Zenoh locator such as 'tcp/127.0.0.1:7447'" in done.stderr
    assert "Traceback" not in done.stderr
