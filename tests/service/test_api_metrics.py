"""What Prometheus scrapes: the figures of real filters, and the bound on labels."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from fuselog.fusion.health import Losses
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown
from fuselog.service.rest.metrics import MOST_LABELS, bounded

from .conftest import ROBOT, Client, Robot

Make = Callable[..., Client]


def scraped(asked: Client) -> dict[tuple[str, ...], float]:
    """Samples by name and the values of their labels, in the order of the labels' names."""
    answer = asked.get("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def test_the_ledger_in_metrics(client: Make, driving: Robot) -> None:
    """Every term of it, adding up to what was received; and the figures of health."""
    driving.fields = {"losses": {"gps": Losses(1, 2, 3, "")}}
    asked = client(driving)
    assert asked.get("/nothing").status_code == 404
    found = scraped(asked)
    terms = {labels[0]: n for (name, *labels), n in found.items() if name == "fuselog_samples_total"}
    assert (terms["fused"], terms["gated"], sum(terms.values())) == (50, 1, 51)
    assert "invalid_clock" in terms
    assert [found["fuselog_lost_total", "robot-1", "gps", why] for why in ("shed", "missed", "unknown")] == [1, 2, 3]
    gps: dict[str, Any] = asked.get(f"{ROBOT}/health").json()["sensors"]["gps"]
    assert found["fuselog_sensor_nis_mean", "robot-1", "gps"] == gps["nis"]["mean"]
    assert found["fuselog_sensor_period_seconds", "robot-1", "gps"] == gps["period_s"]
    assert found["fuselog_filter_status", "robot-1"] == 2
    assert found["fuselog_filters", "degraded"] == 1
    assert found["process_open_fds",] > 0
    assert found["fuselog_http_requests_total", "404"] == 1


class Fleet:
    """Many filters that are one."""

    def __init__(self, robot: Robot, size: int) -> None:
        self._snapshot = replace(
            robot.snapshots()["robot-1"], losses={f"key{i}": Losses(1, 0, 0, "") for i in range(3)}
        )
        self._size = size

    def snapshots(self) -> Mapping[str, Snapshot]:
        """Each under another name."""
        return {f"robot-{i}": self._snapshot for i in range(self._size)}

    @property
    def unknown(self) -> Unknown:
        """Some."""
        return Unknown(7, {"fleet/x/gps": "too many"})

    def ended(self) -> Mapping[str, Snapshot]:
        """None."""
        return {}


def test_labels_are_bounded(client: Make, driving: Robot) -> None:
    """Of 300 filters: 200 sets of labels for each metric, and nothing is lost from the sums."""
    found = scraped(client(Fleet(driving, 300)))
    by_name: dict[str, int] = {}
    for name, *_ in found:
        by_name[name] = by_name.get(name, 0) + 1
    assert max(by_name.values()) == MOST_LABELS
    assert sum(n for (name, *labels), n in found.items() if name == "fuselog_samples_total") == 300 * 51
    assert found["fuselog_samples_total", "other", "other", "other"] > 0
    assert sum(n for (name, *_), n in found.items() if name == "fuselog_lost_total") == 900
    assert sum(n for (name, *_), n in found.items() if name == "fuselog_filters") == 300
    assert found["fuselog_unknown_samples_total",] == 7


@pytest.mark.parametrize(("kind", "rest"), [("counter", 3.0), ("gauge", 2.0)])
def test_the_rest_is_one(kind: Any, rest: float) -> None:
    """Counters are summed; of gauges the greatest is the one to look at."""
    samples = {(f"a{i}", "b"): 0.0 for i in range(199)} | {("x", "b"): 1.0, ("y", "b"): 2.0}
    found = bounded(samples, kind)
    assert len(found) == 200
    assert found["other", "other"] == rest
