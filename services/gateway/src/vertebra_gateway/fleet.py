"""The fleet as it is now: which services are there, how they do, and their metrics."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterator
from typing import Any, Final

import msgspec
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from vertebra.bus import Bus, Delivery
from vertebra.codec import CodecRegistry
from vertebra.errors import TransportError
from vertebra.messages import Status
from vertebra.service import MessageReader, service_key

log = logging.getLogger(__name__)

_QUERY_S: Final = 1.0
_INFO_S: Final = 2.0


class _Service:
    def __init__(self, service: str, instance: str) -> None:
        self.service = service
        self.instance = instance
        self.present = False
        self.version = ""
        self.status: Status | None = None
        self.status_at_s = 0.0

    def describe(self) -> dict[str, Any]:
        heard = self.status is not None
        return {
            "service": self.service,
            "instance": self.instance,
            "present": self.present,
            "version": self.version,
            "status": msgspec.to_builtins(self.status),
            "status_age_s": round(time.monotonic() - self.status_at_s, 3) if heard else None,
        }


class Fleet:
    """All services that were seen since the gateway started."""

    def __init__(self, bus: Bus, codecs: CodecRegistry) -> None:
        self._bus = bus
        self._codecs = codecs
        self._services: dict[tuple[str, str], _Service] = {}

    def describe(self) -> list[dict[str, Any]]:
        """Return a row for each service."""
        return [self._services[name].describe() for name in sorted(self._services)]

    def instances(self, service: str) -> list[str]:
        """Return which instances of a service are present."""
        return [
            found.instance
            for name, found in sorted(self._services.items())
            if name[0] == service and found.present
        ]

    async def follow(self) -> None:
        """Keep the services up to date, for ever."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_statuses())
            async with self._bus.presence(service_key("*", "*", "alive")) as watcher:
                async for event in watcher:
                    service = self._service(event.key)
                    service.present = event.present
                    if event.present:
                        tasks.create_task(self._learn(service))

    async def _follow_statuses(self) -> None:
        subscription = self._bus.subscribe(service_key("*", "*", "status"), Delivery.latest())
        async for received in MessageReader(subscription, self._codecs, Status):
            service = self._service(received.key)
            service.status = received.message
            service.status_at_s = time.monotonic()

    async def _learn(self, service: _Service) -> None:
        key = service_key(service.service, service.instance, "info")
        try:
            reply = await self._bus.call(key, timeout_s=_INFO_S)
            service.version = str(
                msgspec.json.decode(reply.payload, type=dict[str, Any])["version"]
            )
        except (TransportError, msgspec.MsgspecError, KeyError) as error:
            log.warning("%s does not say its version: %s", key, error)

    def _service(self, key: str) -> _Service:
        service, instance = key.split("/")[2:4]
        found = self._services.get((service, instance))
        if found is None:
            found = self._services[service, instance] = _Service(service, instance)
        return found

    async def metrics(self) -> bytes:
        """Return the metrics of all services as Prometheus text, told apart by labels."""
        merged: dict[str, Metric] = {}
        async for reply in self._bus.query(service_key("*", "*", "metrics"), timeout_s=_QUERY_S):
            service, instance = reply.key.split("/")[2:4]
            try:
                families = list(text_string_to_metric_families(reply.payload.decode()))
            except ValueError as error:
                log.error("the metrics of %s cannot be read: %s", reply.key, error)  # noqa: TRY400
                continue
            for family in families:
                whole = merged.setdefault(
                    family.name, Metric(family.name, family.documentation, family.type)
                )
                for sample in family.samples:
                    labels = {**sample.labels, "service": service, "instance": instance}
                    whole.add_sample(sample.name, labels, sample.value)
        registry = CollectorRegistry()
        registry.register(_Collected(merged))
        return generate_latest(registry)


class _Collected(Collector):
    def __init__(self, metrics: dict[str, Metric]) -> None:
        self._metrics = metrics

    def collect(self) -> Iterator[Metric]:
        yield from self._metrics.values()
