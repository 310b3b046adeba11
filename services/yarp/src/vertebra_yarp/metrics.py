"""Per-route counters as Prometheus metrics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from vertebra_yarp.carried import Carried

_LABELS: Final = ("yarp", "key", "kind")
_COUNTED: Final = {
    "messages": "Messages and calls that a route carried",
    "bytes": "Their bytes on the YARP side",
    "dropped": "Messages that a route let go for newer ones, or thinned out",
    "refused": "Messages and calls that a route could not carry",
}


class RouteMetrics(Collector):
    """Reads the traffic of the routes at work whenever metrics are asked for."""

    def __init__(self, carried: Sequence[Carried]) -> None:
        self._carried = carried

    def describe(self) -> list[Metric]:
        """Return nothing: the metrics appear with the routes."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield the counters of all routes, and which of them are connected."""
        rows = {(route.name, route.key, route.kind): route.traffic for route in self._carried}
        for name, text in _COUNTED.items():
            counter = CounterMetricFamily(f"vertebra_yarp_route_{name}", text, labels=_LABELS)
            for labels, traffic in rows.items():
                counter.add_metric(labels, getattr(traffic, name))
            yield counter
        gauge = GaugeMetricFamily(
            "vertebra_yarp_route_connected", "Whether the YARP side is there", labels=_LABELS
        )
        for labels, traffic in rows.items():
            gauge.add_metric(labels, traffic.connected)
        yield gauge
