"""Gains that no longer change, and proof that fixed ones work: the filter about a nominal point, over a period."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import gcd, lcm
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Config, GainSettings, Problem
from fuselog.fusion.design import (
    Corrected,
    DesignError,
    Step,
    absorb_gain,
    check_stable,
    frozen_states,
    make_step,
    period_map,
    periodic_lyapunov,
    periodic_riccati,
    state_gain,
)
from fuselog.fusion.design.steps import correct, predict
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.fields import call
from fuselog.fusion.kernel.memory import begin_history, blank_linear, rest_input, scratch
from fuselog.fusion.kernel.tables import Gain, Missing, Role, Tables
from fuselog.fusion.plan.gains import variants
from fuselog.fusion.plan.sensors import SensorPlan

Floats = NDArray[np.float64]
_MOST_STEPS = 5000  # of a period
_MOST_PERIODS = 20_000  # until a share of the innovation settles
_SETTLED = 1e-10  # relative change of P in a period
_RATES = ("gain", "rates")


class Round(NamedTuple):
    """One period of the samples of all sensors, in their order."""

    dt: list[Fraction]  # s, since the sample before
    moment: list[Fraction]  # s, when it counts
    rank: list[int]
    length: Fraction  # s


class Lag(NamedTuple):
    """What a sensor's innovations must look like, one sample after the other, when its gain is steady."""

    seen: Floats  # (m, n) H F of the error from one of its samples to the next, other sensors' corrections included
    correlation: Floats  # (m,) of each number with its own before


class Settled(NamedTuple):
    """The tables with all steady gains, and by sensor what its innovations must look like with them."""

    tables: Tables
    lags: dict[str, Lag]


def check_rates(config: Config, card: ModelCard, sensors: Sequence[SensorPlan]) -> list[Problem]:
    """What is wrong with a configuration whose gains are to be steady, before anything is computed."""
    gain, problems = config.gain, list[Problem]()
    if not gain.rates and not any(variant.mode == "steady_state" for _, variant in variants(config, [])):
        return []
    measuring = {sensor.name: sensor for sensor in sensors if sensor.role == Role.MEASURES}
    known = {*card.states, *card.inputs}
    for name in gain.nominal:
        if name not in known:
            problems.append(Problem(("gain", "nominal", name), f"{card.name} has no state or input {name!r}"))
    for name in gain.rates:
        if name not in measuring:
            problems.append(Problem((*_RATES, name), "is no sensor that corrects"))
    step = config.model.step
    for name, rate in gain.rates.items():
        if step is not None and abs(1 / rate / step - round(1 / rate / step)) > 1e-6:
            problems.append(Problem((*_RATES, name), f"every {1 / rate:g} s is no whole number of steps of {step:g} s"))
    for name, sensor in measuring.items():
        if name not in gain.rates:
            needs = "mode: steady_state needs" if gain.mode == "steady_state" else "gain.rates lacks"
            problems.append(Problem(_RATES, f"{needs} the rate of {name} (Hz)"))
        bare = [number for number in sensor.names if number not in sensor.settings.noise]
        if sensor.R is None and bare:
            reason = f"a steady gain needs the noise of {', '.join(bare)} here, not in each message"
            problems.append(Problem(("sensors", name), reason))
        if sensor.settings.kind == "beacon_range":
            problems.append(Problem(("sensors", name, "kind"), "has no steady gain: it depends on the beacon"))
    return problems


def settle_gains(
    config: Config, x: Floats, card: ModelCard, sensors: Sequence[SensorPlan], tables: Tables, kernel: ModuleType
) -> Settled | Problem:
    """The tables with all steady gains, and what reacquisition and health need; or why there is none.

    ``x`` (N,) is the state to linearise about, but for the nominal one.

    The schedule of all sensors repeats after the least common multiple of their periods; its periodic Riccati equation
    gives a gain for each sample in it (Bittanti and Colaneri 2009), and a sensor's gain is the mean of its own. With
    these gains, and with fixed ones, the error of the estimate must die out.
    """
    if not config.gain.rates:
        return Settled(tables, {})
    lags: dict[str, Lag] = {}
    rates = {s.rank: config.gain.rates[s.name] for s in sensors if s.role == Role.MEASURES}
    for index, (place, variant) in enumerate(variants(config, [])):
        try:
            order = make_round(rates, tables.period_ns)
            steps = Nominal(variant.nominal, x, card, sensors, tables, kernel).steps(order)
            kept = _closed(steps, list(card.states), variant.open_loop)
            inner = [_without(step, kept) for step in steps]
            states = [list(card.states)[i] for i in kept]
            if variant.mode == "steady_state":
                tables = _steady(tables, index, order, steps, inner, kept, states)
            if variant.mode != "optimal":
                around = _prove(tables, index, order, inner, kept, states)
                worst = np.max([np.diag(o.prior) for o in around], axis=0)
                settled = np.zeros(len(card.states))
                settled[kept] = np.divide(1.0, worst * np.count_nonzero(worst), where=worst > 0, out=0 * worst)
                tables = tables._replace(settled=settled)
                lags = {s.name: _lag(order, inner, around, s.rank) for s in sensors if s.rank in order.rank}
        except DesignError as error:
            return Problem((*place, "mode"), _why(variant, error))
    return Settled(tables, lags)


def check_frozen(
    config: Config,
    x: Floats,
    card: ModelCard,
    sensors: Sequence[SensorPlan],
    tables: Tables,
    kernel: ModuleType,
    P: Floats,
) -> list[Problem]:
    """States of sd 0 that no process noise reaches: nothing would ever correct them."""
    if np.diag(P).all():
        return []
    step = Nominal(config.gain.nominal, x, card, sensors, tables, kernel).move(Fraction(1))
    return [
        Problem(("initial", "sd", state), "0, and no process noise reaches it: nothing would ever correct it")
        for i, state in enumerate(card.states)
        if i in frozen_states(*step, P)
    ]


def _why(variant: GainSettings, error: DesignError) -> str:
    return f"{'no steady gain' if variant.mode == 'steady_state' else 'these weights cannot work'}: {error}"


def make_round(rates: dict[int, float], cycle_ns: int) -> Round:
    """The samples of a period in the total order; in cycles, each sensor's last of a cycle."""
    periods = {rank: 1 / Fraction(rate).limit_denominator(1000) for rank, rate in rates.items()}
    cycle = Fraction(cycle_ns, 1_000_000_000)
    lengths = [*periods.values(), *([cycle] if cycle else [])]
    whole = Fraction(lcm(*(length.numerator for length in lengths)), gcd(*(length.denominator for length in lengths)))
    if sum(whole / period for period in periods.values()) > _MOST_STEPS:
        raise DesignError(f"the rates have no common period of at most {_MOST_STEPS} samples")
    stamps = sorted((k * period, rank) for rank, period in periods.items() for k in range(int(whole / period)))
    ends = [(-(-t // cycle) * cycle if cycle else t, rank) for t, rank in stamps]
    votes = [end for i, end in enumerate(ends) if not cycle or end not in ends[i + 1 :]]
    moments = [t for t, _ in votes]
    before = [moments[-1] - whole, *moments]
    return Round([t - b for t, b in zip(moments, before, strict=False)], moments, [rank for _, rank in votes], whole)


class Nominal:
    """The filter about one point: F, Q, H and R of its steps."""

    def __init__(
        self,
        nominal: Mapping[str, float],
        x: Floats,
        card: ModelCard,
        sensors: Sequence[SensorPlan],
        tables: Tables,
        kernel: ModuleType,
    ) -> None:
        """``nominal`` states and inputs by name; x (N,) where it does not say."""
        x = np.array([nominal.get(name, value) for name, value in zip(card.states, x, strict=True)])
        u = rest_input([nominal.get(name, rest) for name, rest in card.rest.items()])
        for sensor in sensors:
            if sensor.role != Role.MEASURES:
                u[kernel.U :] = [sensor.settings.noise.get(name, 0.0) ** 2 for name in sensor.names]
        N, self._sensors, self._tables, self._kernel = len(x), sensors, tables, kernel
        self._history = begin_history(kernel, tables, 2, x, np.eye(N), np.ones(N, bool), u)
        self._moves: dict[Fraction, tuple[Floats, Floats]] = {}
        self._seen: dict[int, Floats] = {}

    def move(self, dt: Fraction) -> tuple[Floats, Floats]:
        """F and Q (N, N) over dt (s)."""
        N: int = self._kernel.N
        if dt not in self._moves:
            linear = blank_linear(self._kernel, self._tables.M)
            call(self._kernel.transition, self._tables, self._history, linear, 0, float(dt))
            self._moves[dt] = linear.F.reshape(N, N), linear.Q.reshape(N, N)
        return self._moves[dt]

    def seen(self, rank: int) -> Floats:
        """H (m, N) of a sensor."""
        M, N = self._tables.M, int(self._kernel.N)
        if rank not in self._seen:
            linear, work = blank_linear(self._kernel, M), scratch(self._kernel, self._tables)
            call(self._kernel.observation, self._tables, self._history, work, linear, 0, rank)
            self._seen[rank] = linear.H.reshape(M, N)[: self._sensors[rank].dof]
        return self._seen[rank]

    def steps(self, order: Round) -> list[Step]:
        """The period as linear steps."""
        noise = {s.rank: np.eye(s.dof) if s.R is None else s.R for s in self._sensors}
        moves = zip(order.dt, order.rank, strict=True)
        return [make_step(*self.move(dt), self.seen(rank), noise[rank]) for dt, rank in moves]


def _closed(steps: Sequence[Step], states: Sequence[str], open_loop: Sequence[str]) -> list[int]:
    """The states that the proof is about; those left out must not reach them, nor be measured."""
    out = [states.index(name) for name in open_loop]
    kept = [i for i in range(len(states)) if i not in out]
    for step in steps:
        for i in out:
            if step.H[:, i].any() or step.F[kept, i].any():
                raise DesignError(f"{states[i]} is not open_loop: a sensor or another state depends on it")
    return kept


def _without(step: Step, kept: list[int]) -> Step:
    inside = np.ix_(kept, kept)
    return Step(F=step.F[inside], Q=step.Q[inside], H=step.H[:, kept], R=step.R)


def _steady(
    tables: Tables,
    index: int,
    order: Round,
    steps: Sequence[Step],
    inner: Sequence[Step],
    kept: list[int],
    states: Sequence[str],
) -> Tables:
    """The tables with the steady gain of variant ``index``."""
    S, M, N = tables.S, tables.M, len(steps[0].F)
    optimal = periodic_riccati(inner, states=tuple(states))
    table, gain = tables.table.reshape(-1, S, M, N).copy(), tables.gain.reshape(-1, S).copy()
    for rank in set(order.rank):
        mean = np.mean([o.G for r, o in zip(order.rank, optimal, strict=True) if r == rank], axis=0)
        table[index, rank, : mean.shape[1], kept] = mean
    gain[index] = Gain.MATRIX
    return tables._replace(gain=gain.ravel(), table=table.ravel())


def _prove(
    tables: Tables, index: int, order: Round, steps: Sequence[Step], kept: list[int], states: Sequence[str]
) -> tuple[Corrected, ...]:
    """The steady covariances of a variant around the period; raises ``DesignError`` where errors do not decay."""
    S, M = tables.S, tables.M
    weight = tables.weight.reshape(-1, S, M)[index]
    table = tables.table.reshape(-1, S, M, len(tables.scales))[index][:, :, kept]
    policy = Gain(int(tables.gain.reshape(-1, S)[index, 0]))
    if policy == Gain.ABSORB:
        shares = _votes(tables, order, weight[:, :, np.newaxis] * _kinds(tables))
        fixed = np.diag(tables.scales[kept] ** 2) if tables.scaled else None
        return _absorbed(fixed, steps, [share.sum(axis=1)[: len(s.H)] for share, s in zip(shares, steps, strict=True)])
    if policy == Gain.STATE:
        votes = _votes(tables, order, table)
        gains = [state_gain(vote[: len(step.H)].T, step.H) for vote, step in zip(votes, steps, strict=True)]
    else:
        gains = [table[rank, : len(step.H)].T for rank, step in zip(order.rank, steps, strict=True)]
    return periodic_lyapunov(steps, gains, states=tuple(states))


def _lag(order: Round, steps: Sequence[Step], around: Sequence[Corrected], rank: int) -> Lag:
    """C_1 = H F (K - G) S from one sample of a sensor to its next (Mehra 1970), with what others do in between."""
    n, first = len(steps), order.rank.index(rank)
    G, S, prior, H = around[first].G, around[first].S, around[first].prior, steps[first].H
    error = np.eye(len(prior))
    for k in range(first + 1, first + n + 1):
        error = steps[k % n].F @ error
        if order.rank[k % n] == rank:
            break
        error = error - around[k % n].G @ steps[k % n].H @ error
    seen = H @ error
    return Lag(seen, np.diag(seen @ (prior @ H.T - G @ S)) / np.diag(S))


def _kinds(tables: Tables) -> Floats:
    """(S, M, T): 1 where a number measures the same as others of kind t."""
    what = tables.what.reshape(tables.S, tables.M)
    return (what[:, :, np.newaxis] == np.unique(what)).astype(np.float64)


def _votes(tables: Tables, order: Round, table: Floats) -> list[Floats]:
    """The weights (M, T) in T targets that each sample has, given those (S, M, T) in the configuration.

    As the filter does it: shares of the missing, then what the later ones of the moment leave (``design.weights``).
    """
    if not tables.cycles:
        return [table[rank] for rank in order.rank]
    toward, max_age = table.sum(axis=1), Fraction(tables.max_age_ns, 1_000_000_000)
    whole, votes = toward.sum(axis=0), list[Floats]()
    for i, (now, rank) in enumerate(zip(order.moment, order.rank, strict=True)):
        here = {r for t, r in zip(order.moment, order.rank, strict=True) if t == now}
        heard = {r for t, r in zip(order.moment, order.rank, strict=True) if (now - t) % order.length <= max_age} | here
        absent = sum((toward[r] for r in range(tables.S) if r not in heard), np.zeros(len(whole)))
        later = {r for t, r in zip(order.moment[i + 1 :], order.rank[i + 1 :], strict=True) if t == now}
        factor = np.ones(len(whole))
        if tables.missing == Missing.RENORMALIZE:
            factor = np.divide(whole, whole - absent, out=factor, where=whole > absent)
        elif tables.missing == Missing.RESCALE:
            factor = np.divide(1.0, 1.0 - absent, out=factor, where=absent < 1)
        elif tables.missing == Missing.SKIP and absent.any():
            factor[:] = 0.0
        left = 1.0 - factor * sum((toward[r] for r in later), np.zeros(len(whole)))
        votes.append(table[rank] * np.divide(factor, left, out=np.zeros(len(whole)), where=left > 0))
    return votes


def _absorbed(fixed: Floats | None, steps: Sequence[Step], shares: Sequence[Floats]) -> tuple[Corrected, ...]:
    """The steady covariances of shares of the innovation: their gain follows P till it settles, or ``fixed`` scales."""
    posterior: Floats = np.eye(len(steps[0].F))
    around: list[Corrected] = []
    for _ in range(_MOST_PERIODS):
        before, around = posterior, []
        for step, share in zip(steps, shares, strict=True):
            prior = predict(posterior, step)
            around.append(correct(prior, step, absorb_gain(prior if fixed is None else fixed, step.H, share)))
            posterior = around[-1].posterior
        if np.abs(posterior - before).max() <= _SETTLED * np.abs(posterior).max():
            break
    check_stable(period_map(steps, [o.G for o in around]))
    return tuple(around)
