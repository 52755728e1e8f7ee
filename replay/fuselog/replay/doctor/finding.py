"""One thing that a log should not have, and what to do about it."""

from dataclasses import dataclass
from typing import Any, Final, Literal

Severity = Literal["error", "warning", "note"]

# Code of a finding: how bad it is, and what to do. Errors are data that are lost or damaged.
_KINDS: Final[dict[str, tuple[Severity, str]]] = {
    "truncated": ("error", "Rescue the rest with `fuselog recover`, and record with a writer that syncs."),
    "crc": ("error", "Copy the log anew from where it was recorded, or leave the damaged part with `fuselog recover`."),
    "damaged": ("error", "Copy the log anew from where it was recorded, or rescue the rest with `fuselog recover`."),
    "limit": ("error", "Raise the limit that is named if you trust the log."),
    "statistics": ("error", "Messages went or came since it was written: find the copy that has them."),
    "payload": ("error", "Look at the publisher: its messages are not of the type that it declares."),
    "mended": ("warning", "Write a sound copy with `fuselog recover`."),
    "long_payload": ("warning", "Publisher and schema differ in version: record with the schema of the publisher."),
    "no_schema": ("warning", "Record with schemas: without one these messages cannot be decoded."),
    "schema": ("warning", "Mend the schema in the log: these messages cannot be decoded with it."),
    "gaps": ("warning", "Look for lost connections, full disks or a busy machine at these times."),
    "log_order": ("warning", "Sort it if a tool needs order; fuselog reads it in order of log time."),
    "stamp_order": ("warning", "Give the filter a `lag.window` larger than this."),
    "duplicate_stamps": ("warning", "Look for a publisher that runs twice; the filter uses the first one only."),
    "no_stamps": ("warning", "Set the stamp where the sample is taken."),
    "skew": ("warning", "Synchronise the clocks of sensor and recorder, or estimate the delay of the sensor."),
    "drift": ("warning", "Synchronise the clocks of sensor and recorder."),
    "not_finite": ("warning", "Leave these fields out, or expect such samples to be refused as invalid."),
    "frozen": (
        "warning",
        "Look at the sensor, unless it stood still: it repeated one value while its messages went on.",
    ),
    "jitter": ("note", "Use the stamps, not the time of arrival."),
    "constant": ("note", "Nothing is measured here, or the field is a parameter."),
    "unused": ("note", "Do not fuse these fields: they hold no number."),
    "not_examined": ("note", "fuselog cannot decode this encoding; only its times were looked at."),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What was found, ``count`` times; ``offset`` is a byte of the file, ``t_ns`` a log time where it begins."""

    code: str
    text: str
    count: int
    topic: str | None = None
    field: str | None = None
    offset: int | None = None
    t_ns: int | None = None

    @property
    def severity(self) -> Severity:
        """``error`` for data that are lost or damaged."""
        return _KINDS[self.code][0]

    @property
    def advice(self) -> str:
        """What to do, in one sentence."""
        return _KINDS[self.code][1]

    @property
    def place(self) -> str:
        """Where it is, for people."""
        if self.topic is None:
            return "the log" if self.offset is None else f"byte {self.offset}"
        return self.topic if self.field is None else f"{self.topic} {self.field}"

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        where = {"topic": self.topic, "field": self.field, "offset": self.offset, "t_ns": self.t_ns}
        what = {"count": self.count, "text": self.text, "advice": self.advice}
        return {"severity": self.severity, "code": self.code, "place": self.place} | where | what
