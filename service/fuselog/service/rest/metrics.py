"""What Prometheus scrapes: the figures of health as metrics, with a bound on the number of their labels."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, NamedTuple

from fastapi import FastAPI, Response
from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from fuselog.service.rest.shown import Shown
from fuselog.service.rest.traffic import Traffic

MOST_LABELS = 200  # sets of labels of one metric
OTHER = "other"
_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_STATUS = {"initializing": 0, "waiting": 0, "healthy": 1, "ok": 1, "degraded": 2, "diverged": 3, "stale": 4}
_NOT_FIGURES = ("account", "losses", "status", "sensors", "recording", "unpublished", "idle_s")  # metrics of their own


class _Family(NamedTuple):
    """One metric: its samples by their labels, before there are too many."""

    kind: Literal["counter", "gauge"]
    help: str
    labels: tuple[str, ...]
    samples: dict[tuple[str, ...], float]


class FilterMetrics(Collector):
    """Reads the filters at each scrape.

    Beyond 199 sets of labels of a metric the rest is one more, named ``other``: the sum for counters, the greatest
    for gauges. Every number in the health of a filter or sensor is a gauge ``fuselog_filter_...`` or
    ``fuselog_sensor_...`` without a line here.
    """

    def __init__(self, shown: Shown, traffic: Traffic) -> None:
        self._shown, self._traffic = shown, traffic

    def collect(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        """The metrics as they are now."""
        families: dict[str, _Family] = {}
        for id, snapshot in self._shown.all().items():
            _of_filter(families, id, self._shown.health(id))
            for key, losses in snapshot.losses.items():
                for term in ("shed", "missed", "unknown"):
                    _add(
                        families, "lost", "counter", _HELP["lost"], getattr(losses, term), filter=id, key=key, why=term
                    )
        _add(families, "unknown_samples", "counter", _HELP["unknown_samples"], self._shown.served.unknown.samples)
        _of_traffic(families, self._traffic)
        for name, family in families.items():
            made = CounterMetricFamily if family.kind == "counter" else GaugeMetricFamily
            metric = made(f"fuselog_{name}", family.help, labels=family.labels)
            for labels, value in bounded(family.samples, family.kind).items():
                metric.add_metric(labels, value)
            yield metric


_HELP = {
    "filters": "Filters by status",
    "filter_status": "0 initializing, 1 healthy, 2 degraded, 3 diverged, 4 stale",
    "unpublished": "Results dropped because subscribers were too slow",
    "idle_seconds": "Since any sample came",
    "samples": "Samples by what became of them; with those pending their sum is what was received",
    "pending": "Samples that wait",
    "lost": "Samples that came to no sensor, by key",
    "unknown_samples": "Samples of subscribed keys that belong to no filter",
    "sensor_status": "0 ok, 1 waiting, 2 degraded, 3 stale, 4 disabled",
    "recording": "1 while it records",
    "recorded_bytes": "Of all files",
    "recorded": "Messages by what became of them in the recording",
}
_SENSOR_STATUS = {"ok": 0, "waiting": 1, "degraded": 2, "stale": 3, "disabled": 4}


def bounded(
    samples: Mapping[tuple[str, ...], float], kind: Literal["counter", "gauge"]
) -> dict[tuple[str, ...], float]:
    """At most ``MOST_LABELS`` sets of labels."""
    if len(samples) <= MOST_LABELS:
        return dict(samples)
    items = list(samples.items())
    kept, rest = items[: MOST_LABELS - 1], [value for _, value in items[MOST_LABELS - 1 :]]
    return {**dict(kept), (OTHER,) * len(items[0][0]): sum(rest) if kind == "counter" else max(rest)}


def _of_filter(families: dict[str, _Family], id: str, health: dict[str, Any]) -> None:
    def add(name: str, kind: Literal["counter", "gauge"], value: Any, **labels: str) -> None:
        _add(families, name, kind, _HELP[name], value, filter=id, **labels)

    _count(families, health["status"])
    add("filter_status", "gauge", _STATUS.get(health["status"]))
    add("unpublished", "counter", health["unpublished"])
    add("idle_seconds", "gauge", health["idle_s"])
    for figure, value in _figures(health):
        _add(families, f"filter_{figure}", "gauge", _described("filter", figure), value, filter=id)
    for name, sensor in health["sensors"].items():
        add("sensor_status", "gauge", _SENSOR_STATUS.get(sensor["status"]), sensor=name)
        add("pending", "gauge", sensor["account"]["pending"], sensor=name)
        for term, value in _terms(sensor["account"]):
            add("samples", "counter", value, sensor=name, became=term)
        for figure, value in _figures(sensor):
            _add(families, f"sensor_{figure}", "gauge", _described("sensor", figure), value, filter=id, sensor=name)
    if health["recording"] is not None:
        recording = health["recording"]
        add("recording", "gauge", recording["state"] == "recording")
        add("recorded_bytes", "counter", recording["bytes"])
        for term in ("written", "waiting", "expired"):
            add("recorded", "gauge", recording[term], became=term)
        for reason, value in recording["dropped"].items():
            add("recorded", "gauge", value, became=f"dropped_{reason}")


def _count(families: dict[str, _Family], status: str) -> None:
    family = families.setdefault("filters", _Family("gauge", _HELP["filters"], ("status",), {}))
    family.samples[status,] = family.samples.get((status,), 0) + 1


def _terms(account: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """The terms of an account, those of invalid one by one."""
    for term, value in account.items():
        if isinstance(value, Mapping):
            yield from ((f"{term}_{reason}", int(each)) for reason, each in value.items())  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]  counters by reason
        elif term not in ("received", "pending") and not isinstance(value, bool):
            yield term, int(value)


def _figures(health: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """The numbers in the health of a filter or sensor, and in the groups in it; stamps are none."""
    for name, value in health.items():
        if name in _NOT_FIGURES or name.endswith("_ns"):
            continue
        if isinstance(value, int | float):
            yield _named(name), float(value)
        elif isinstance(value, Mapping):
            for inner, each in value.items():  # pyright: ignore[reportUnknownVariableType]  plain data
                if isinstance(each, int | float) and not str(inner).endswith("_ns"):  # pyright: ignore[reportUnknownArgumentType]  the same
                    yield _named(f"{name}_{inner}"), float(each)


def _named(figure: str) -> str:
    return figure.removesuffix("_s") + "_seconds" if figure.endswith("_s") else figure


def _described(what: str, figure: str) -> str:
    return f"As health says of a {what}: {figure.replace('_', ' ')}"


def _of_traffic(families: dict[str, _Family], traffic: Traffic) -> None:
    for status, n in traffic.answered.items():
        _add(families, "http_requests", "counter", "Requests by status of the answer", n, status=str(status))
    closed = {"slow": traffic.slow, "unread": traffic.unread, "crowded": traffic.crowded}
    for why, n in closed.items():
        _add(families, "http_closed", "counter", "Connections closed by the service", n, why=why)
    _add(families, "http_active", "gauge", "Requests under way, without streams", traffic.active)
    _add(families, "http_streams", "gauge", "Clients of the stream", traffic.streams)


def _add(
    families: dict[str, _Family], name: str, kind: Literal["counter", "gauge"], help: str, value: Any, **labels: str
) -> None:
    if value is None:
        return
    family = families.setdefault(name, _Family(kind, help, tuple(labels), {}))
    family.samples[tuple(labels.values())] = float(value)


def add_metrics(app: FastAPI, collectors: Iterable[Collector], process: int | None = None) -> None:
    """``/metrics`` in the text format of Prometheus, with the figures of a process, by default of this one."""
    registry = CollectorRegistry(auto_describe=False)
    for collector in collectors:
        registry.register(collector)
    ProcessCollector(pid=lambda: "self" if process is None else process, registry=registry)
    PlatformCollector(registry=registry)

    @app.get(
        "/metrics",
        tags=["metrics"],
        operation_id="metrics",
        response_class=Response,
        responses={200: {"description": "Metrics", "content": {"text/plain": {"schema": {"type": "string"}}}}},
    )
    async def metrics() -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """What Prometheus scrapes."""
        return Response(generate_latest(registry), headers={"Content-Type": _TYPE})
