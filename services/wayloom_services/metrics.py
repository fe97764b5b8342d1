"""Prometheus metrics. Labels are route templates and known methods, never text that a client chose."""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class CountedElsewhere(Collector):
    """Counters that the database keeps. counts : by value of the label, one number for each counter, in their order"""

    def __init__(self, counters: Mapping[str, str], label: str) -> None:
        self._counters, self._label = counters, label
        self.counts: Mapping[str, Sequence[int]] = {}

    def collect(self) -> Iterator[Metric]:
        """As they were set last."""
        for position, (name, about) in enumerate(self._counters.items()):
            family = CounterMetricFamily(name, about, labels=[self._label])
            for value, numbers in self.counts.items():
                family.add_metric([value], numbers[position])
            yield family


class Metrics:
    """The counters of one application, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self.requests = Counter("wayloom_http_requests", "Requests answered", labels, registry=self.registry)
        self.seconds = Histogram("wayloom_http_request_seconds", "Time to answer", ("method", "route"), registry=self.registry)
        self.upload_bytes = Counter("wayloom_upload_bytes", "Bytes of drives received", registry=self.registry)
        self.jobs = Gauge("wayloom_jobs", "Jobs by stage and state", ("stage", "state"), registry=self.registry)
        self.drives = Gauge("wayloom_drives", "Drives by state", ("state",), registry=self.registry)
        self.estimates = CountedElsewhere(
            {
                "wayloom_eta_judged": "Intervals of remaining time that were judged, by the stage as which began they were told",
                "wayloom_eta_within": "Those of them that the truth lay within",
            },
            "stage",
        )
        self.registry.register(self.estimates)
        self.map_version = Gauge("wayloom_map_version", "Published version of each map", ("map",), registry=self.registry)

    def exposition(self) -> bytes:
        """The text that Prometheus reads."""
        return generate_latest(self.registry)


class CountRequests:
    """ASGI middleware that counts and times every request."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started, status = time.perf_counter(), 500

        async def note_status(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, note_status)
        finally:
            route = getattr(scope.get("route"), "path", None) or "unknown"
            method = scope["method"] if scope["method"] in METHODS else "other"
            self._metrics.requests.labels(method, route, str(status)).inc()
            self._metrics.seconds.labels(method, route).observe(time.perf_counter() - started)
