"""The health of one channel: what was gathered of it, as numbers and as findings."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from fuselog.replay.doctor.finding import Finding
from fuselog.replay.doctor.payloads import Payloads
from fuselog.replay.doctor.stamps import Stamps
from fuselog.replay.doctor.timing import Timing
from fuselog.replay.doctor.values import Values
from fuselog.replay.log.channels import Channel
from fuselog.schemas.messages import Fault, Messages

_FEWEST = 20  # messages below which nothing is said of a rhythm
_GAP = 3  # median periods that make a gap
_JITTER = 0.5  # median periods
_BEHIND, _AHEAD = 0.5, -0.001  # s between which a log time may lie from its stamp
_DRIFT_PPM = 100.0  # clocks without synchronisation stay within


class TopicHealth:
    """Takes the messages of one channel, in the order of the file."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self._timing = Timing()
        self._stamps = Stamps()
        self._payloads = Payloads(channel)
        self._values = Values(self._payloads.paths)

    @property
    def count(self) -> int:
        """Messages so far."""
        return self._timing.count

    def add(self, messages: Messages) -> None:
        """Take the next messages."""
        self._timing.add(messages.log_time)
        for columns, log_time in self._payloads.decode(messages):
            self._values.add(columns.values, log_time)
            if self._payloads.has_stamp:
                self._stamps.add(columns.t_ns, log_time)

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain data; null where there are none."""
        timing, stamps = self._timing, self._stamps
        median, (drift, _) = timing.periods.quantile(0.5), stamps.delays.drift()
        several = timing.count > 1
        return {
            "topic": self.channel.topic,
            "type": self.channel.schema.name,
            "messages": timing.count,
            "rate_hz": (timing.count - 1) / timing.seconds if timing.seconds > 0 else None,
            "period_s": median,
            "jitter_s": timing.jitter if several else None,
            "longest_gap_s": timing.periods.longest_ns * 1e-9 if several else None,
            "gaps": self._gaps(),
            "late": timing.order.late,
            "late_s": timing.order.depth_ns * 1e-9,
            "stamps_late": stamps.order.late,
            "stamps_late_s": stamps.order.depth_ns * 1e-9,
            "duplicate_stamps": stamps.duplicates,
            "skew_s": stamps.delays.median,
            "drift_ppm": drift,
            "faults": sum(self._payloads.faults.values()),
            "not_finite": self._values.messages_not_finite,
        }

    def findings(self) -> Iterator[Finding]:
        """What is wrong with it."""
        yield from self._of_payloads()
        yield from self._of_times()
        yield from self._of_stamps()
        yield from self._of_values()

    def _finding(self, code: str, text: str, count: int, **where: Any) -> Finding:
        return Finding(code=code, text=text, count=count, topic=self.channel.topic, **where)

    def _gaps(self) -> int:
        median = self._timing.periods.quantile(0.5)
        return self._timing.periods.above(_GAP * median) if self.count >= _FEWEST and median > 0 else 0

    def _of_payloads(self) -> Iterator[Finding]:
        payloads = self._payloads
        if payloads.refused is not None:
            code, reason = payloads.refused
            yield self._finding(code, f"{self.channel.schema.name or 'no type'}: {reason}", self.count)
        for kind, what in ((Fault.SIZE, "cut short"), (Fault.SCHEMA, "of another shape than their schema says")):
            if payloads.faults[kind]:
                text = f"payloads {what}"
                yield self._finding("payload", text, payloads.faults[kind], t_ns=payloads.first_fault)
        if payloads.too_long:
            text = "payloads longer than their type"
            yield self._finding("long_payload", text, payloads.too_long, t_ns=payloads.first_too_long)

    def _of_times(self) -> Iterator[Finding]:
        timing = self._timing
        median = timing.periods.quantile(0.5)
        if gaps := self._gaps():
            longest = timing.periods.longest_ns * 1e-9
            text = f"gaps of more than {_GAP} median periods of {median:.3g} s, the longest {longest:.3f} s"
            yield self._finding("gaps", text, gaps, t_ns=timing.periods.longest_at)
        if timing.order.late:
            text = f"messages behind later ones in the file, by up to {timing.order.depth_ns * 1e-9:.6g} s"
            yield self._finding("log_order", text, timing.order.late)
        if self.count >= _FEWEST and median > 0 and timing.jitter > _JITTER * median:
            text = f"periods vary by {timing.jitter:.3g} s about {median:.3g} s"
            yield self._finding("jitter", text, self.count)

    def _of_stamps(self) -> Iterator[Finding]:
        stamps, delays = self._stamps, self._stamps.delays
        if stamps.unset:
            yield self._finding("no_stamps", "stamps of 0", stamps.unset)
        if stamps.order.late:
            text = f"stamps behind earlier ones, by up to {stamps.order.depth_ns * 1e-9:.6g} s"
            yield self._finding("stamp_order", text, stamps.order.late)
        if stamps.duplicates:
            yield self._finding(
                "duplicate_stamps", "stamps that were there", stamps.duplicates, t_ns=stamps.first_duplicate
            )
        if not _AHEAD <= delays.median <= _BEHIND and not np.isnan(delays.median):
            text = f"log times are {abs(delays.median):.6g} s {'before' if delays.median < 0 else 'after'} their stamps"
            yield self._finding("skew", text, stamps.count)
        drift, noise = delays.drift()
        if abs(drift) > max(_DRIFT_PPM, noise):
            text = f"log times and stamps drift apart by {drift:.0f} ppm (noise {noise:.0f} ppm)"
            yield self._finding("drift", text, stamps.count)

    def _of_values(self) -> Iterator[Finding]:
        values = self._values
        shares = values.not_finite / max(values.count, 1)
        bad = {path: share for path, share in zip(values.paths, shares.tolist(), strict=True) if share > 0}
        unused = [path for path, share in bad.items() if share == 1]
        some = {path: share for path, share in bad.items() if share < 1}
        if some:
            text = "NaN or infinity in " + _listed([f"{path} ({100 * share:.2g} %)" for path, share in some.items()])
            count = int(max(values.not_finite[list(values.paths).index(path)] for path in some))
            yield self._finding("not_finite", text, count)
        if unused:
            yield self._finding("unused", "no number at all in " + _listed(unused), len(unused))
        for path, messages, t_ns, value in values.frozen():
            text = f"stays at {value:.6g} for {messages} messages, but changes with every other one"
            yield self._finding("frozen", text, messages, field=path, t_ns=t_ns)
        if constant := values.constant():
            text = "never changes: " + _listed([f"{path} = {value:.6g}" for path, value in constant.items()])
            yield self._finding("constant", text, len(constant))


def _listed(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
