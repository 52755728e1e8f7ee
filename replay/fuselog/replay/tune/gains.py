"""Fixed gains found from a log, and what they do on a part of it that they were not found by."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan, compile_plan, parse_config
from fuselog.fusion.config import Problem
from fuselog.fusion.design import DesignError, UnstableError, periodic_riccati
from fuselog.replay.log import Log
from fuselog.replay.measured import Sampled, read_events
from fuselog.replay.truth import Truth
from fuselog.replay.tune.copy import text_with_gain
from fuselog.replay.tune.forms import Form, fixed_settings, gain_settings, present_gains, with_gain
from fuselog.replay.tune.hat import with_noise_of_log
from fuselog.replay.tune.held_out import Fit, fit, replay
from fuselog.replay.tune.inverse_variance import inverse_variance_gains
from fuselog.replay.tune.kappa import kappa_gains
from fuselog.replay.tune.learn import learn_gains
from fuselog.replay.tune.linear import Gains, Linear, linearise
from fuselog.replay.tune.observed import Observed, measuring_sensors, observe

Floats = NDArray[np.float64]
Method = Literal["inverse_variance", "dare", "kappa", "learn"]
Noise = Literal["given", "log"]
_ASTRAY = 3.0  # times the innovations that there were before

ReadTruth = Callable[[Floats | None], Truth]  # from the datum of the filter


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """Gains found, the configuration with them, and how both configurations do on the held-out part of the log."""

    by: Method
    form: Form
    accepted: bool
    reason: str | None  # why they were not
    text: str  # the configuration with the new gains, or as it was where they were not accepted
    gain: Mapping[str, Any]  # its gain section as found
    radius: float  # spectral radius of a period of (I - G H) F
    seen: Observed
    from_ns: int  # where the held-out part begins
    before: Fit
    after: Fit | None  # None where the filter would not be stable
    learning: tuple[float, ...]  # prediction error on the other part, round by round

    def to_json(self) -> dict[str, Any]:
        """The result as plain data."""
        after = None if self.after is None else self.after.to_json()
        return {
            "schema": 1,
            "by": self.by,
            "form": self.form,
            "accepted": self.accepted,
            "reason": self.reason,
            "gain": self.gain,
            "spectral_radius": self.radius,
            "log": {
                "rates": {name: asdict(pace) for name, pace in self.seen.paces.items()},
                "noise": {name: R.tolist() for name, R in self.seen.noise.items()},
                "nominal": self.seen.nominal,
            },
            "learning": list(self.learning),
            "held_out": {"from_ns": self.from_ns, "before": self.before.to_json(), "after": after},
        }


def tune_gains(
    log: Log,
    plan: Plan,
    *,
    by: Method,
    form: Form | None = None,
    noise: Noise = "given",
    kappa: Mapping[str, float] | None = None,
    open_loop: Sequence[str] = (),
    hold_out: float = 0.3,
    truth: ReadTruth | None = None,
) -> Tuned:
    """Find the gains of every sensor by the first part of a log, and judge them on the last share ``hold_out``.

    ``noise``: as the configuration or the messages give it, or from the log where three sensors measure one state.
    ``open_loop`` names states that nothing measures, ``kappa`` how much the variance of each other one matters.
    Gains with which the filter goes astray are not accepted, and learned ones only where they predict the held-out
    part better. Raises ``ConfigError`` for what cannot be tuned, with its place; ``LogError`` for an unreadable log.
    """
    if plan.config.gain.covariance == "none":
        raise plan.source.complain([Problem(("gain", "covariance"), "is needed to compare gains: leave it out")])
    open_loop = [*dict.fromkeys([*plan.config.gain.open_loop, *open_loop])]
    now = replay(log, plan)
    true = None if truth is None else truth(now.datum)
    sampled = read_events(log, plan)
    from_ns = _split(plan, sampled, hold_out)
    seen = observe(plan, sampled, now.track, from_ns)
    if noise == "log":
        seen = with_noise_of_log(plan, seen)
    linear = linearise(plan, seen, open_loop)
    try:
        gains, learning = _find(by, log, linear, kappa or {})
        form = form or _form(by, plan)
        settings = gain_settings(linear, gains, form)
        written = present_gains(replace(linear, plan=with_gain(plan, fixed_settings(linear, gains, form))))
        unstable = _unstable(linear, written)
        if unstable is not None and by != "learn":
            raise unstable
        text = text_with_gain(plan.source, settings)
        before, after = fit(plan, now, from_ns, true), None
        if unstable is None:
            tuned = compile_plan(*parse_config(text, name=plan.source.name))
            after = fit(tuned, replay(log, tuned), from_ns, true)
    except DesignError as error:
        raise linear.refuse(f"no gain by {by}: {error}") from error
    reason = str(unstable) if after is None else _diverged(before, after)
    if after is not None and reason is None and by == "learn":
        reason = _no_better(before, after, learning)
    return Tuned(
        by=by,
        form=form,
        accepted=reason is None,
        reason=reason,
        text=text if reason is None else plan.source.text,
        gain=settings,
        radius=float(np.abs(np.linalg.eigvals(linear.error_map(written))).max()),
        seen=seen,
        from_ns=from_ns,
        before=before,
        after=after,
        learning=learning,
    )


def _split(plan: Plan, sampled: Sampled, hold_out: float) -> int:
    """The time (ns) that leaves the share ``hold_out`` of the samples' time after it."""
    stamps = [sampled.samples[s.name].t_ns for s in measuring_sensors(plan) if s.name in sampled.samples]
    stamps = [t for t in stamps if len(t)]
    if not stamps:
        raise plan.source.complain([Problem(("sensors",), "the log has no good sample of any sensor that corrects")])
    first, last = min(int(t.min()) for t in stamps), max(int(t.max()) for t in stamps)
    return last - round((last - first) * hold_out)


def _find(by: Method, log: Log, linear: Linear, kappa: Mapping[str, float]) -> tuple[Gains, tuple[float, ...]]:
    if by == "learn":
        learned = learn_gains(log, linear)
        return learned.gains, learned.errors
    if by == "kappa":
        return kappa_gains(linear, kappa), ()
    if by == "inverse_variance":
        return inverse_variance_gains(linear), ()
    return linear.mean([one.G for one in periodic_riccati(linear.steps, states=linear.states)]), ()


def _form(by: Method, plan: Plan) -> Form:
    """What the method finds where it has no cross gains; else as it is, or shares, which suit any geometry."""
    if by in ("inverse_variance", "kappa"):
        return "state"
    return plan.config.gain.form if plan.config.gain.mode == "fixed" else "absorb"


def _unstable(linear: Linear, gains: Gains) -> DesignError | None:
    """Why errors of the estimate would not die out, if they would not."""
    try:
        linear.check_stable(gains)
    except UnstableError as error:
        return error
    return None


def _diverged(before: Fit, after: Fit) -> str | None:
    """Why gains are of no use away from the point that they are made for, if they are not."""
    for name, was in before.sensors.items():
        if name not in after.sensors:
            return f"no sample of {name} can be used any more"
        for number, rms in after.sensors[name].innovation_rms.items():
            old = was.innovation_rms[number]
            if not rms <= _ASTRAY * old:
                return f"the filter goes astray: {name}.{number} has an innovation RMS of {rms:.3g}, {old:.3g} before"
    return None


def _no_better(before: Fit, after: Fit, learning: Sequence[float]) -> str | None:
    """Why learned gains are not accepted, if they are not."""
    if len(learning) < 2:
        return "no other gain predicts the samples that it is learned from better"
    if after.prediction_error < before.prediction_error:
        return None
    return (
        f"the learned gain predicts the held-out part no better: {after.prediction_error:.6g},"
        f" {before.prediction_error:.6g} before"
    )
