"""Bezmen 2019: one quantity, three sensors, and weights that somebody chose."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.fusion.design import (
    MissingRule,
    covariances,
    fixed_weights,
    frozen_states,
    inverse_variance,
    lyapunov,
    make_step,
    present_weights,
    undetectable_modes,
)
from fuselog.fusion.design.steps import correct, optimal_gain
from fuselog.replay.articles.line import line_plan
from fuselog.replay.articles.result import (
    Erratum,
    Experiment,
    Figure,
    Line,
    Panel,
    Picture,
    Proof,
    mean_figure,
    rms_figure,
)
from fuselog.replay.articles.runs import Runs, fuse_runs, plan_of, simulate_runs, times
from fuselog.replay.articles.theory import riccati
from fuselog.replay.scenarios.bezmen import Redundant, redundant_signals
from fuselog.replay.scenarios.line import Particle, particle_signals
from fuselog.replay.signals import Signal, reading, stamps

Floats = NDArray[np.float64]

THREE = Redundant(missing=0.0)
STEPS = 400
_SETTLED = 20  # steps after which means begin
_EXACT = 1e-9


def three_plan(
    redundant: Redundant, weights: Floats | None = None, *, start: float = 0.0, missing: MissingRule = "rescale"
) -> Plan:
    """Three sensors of x; ``weights`` as the article has them, all at once (eq. 29), or the optimal gain."""
    gain: dict[str, Any] = {}
    if weights is not None:
        row = {f"{name}.x": weight for name, weight in zip("abc", weights.tolist(), strict=True)}
        gain = {"mode": "fixed", "form": "state", "weights": {"x": row}, "cycle": {"missing": missing}}
    return plan_of(
        model={"name": "brownian", "process_noise": {"x": redundant.sigma_w**2 / redundant.dt}},
        initial={"state": {"x": start}, "sd": {"x": _EXACT}},
        gain=gain,
        sensors={
            name: {"topic": f"/sensor/{name}", "fuse": ["x"], "fields": {"x": "values[0]"}, "noise": {"x": sd}}
            for name, sd in zip("abc", redundant.sd.tolist(), strict=True)
        },
    )


def weights(runs: int, redundant: Redundant = THREE) -> Experiment:
    """The same samples by four sets of weights."""
    r = redundant.sd**2
    optimal = fixed_weights(redundant.sigma_w**2, r)
    signals = simulate_runs(redundant_signals, redundant, STEPS * redundant.dt, max(50, runs // 5), seed=41)
    world = make_step([[1.0]], [[redundant.sigma_w**2]], np.ones((3, 1)), np.diag(r))
    best = riccati(world, STEPS, [[0.0]])[-1]
    ways = {
        "optimal gain": None,
        "fixed weights that are optimal": optimal,
        "weights 1/r, sum 1": inverse_variance(r),
        "equal thirds": np.full(3, 1 / 3),
    }
    figures = [
        Figure(
            name="largest difference of s*·w from the optimal gain",
            ours=float(np.abs(optimal - best.G[0]).max()),
            expected=0.0,
            slack=1e-12,
            note="g = " + ", ".join(f"{g:.3f}" for g in optimal),
        ),
    ]
    fused: dict[str, Runs] = {}
    for name, given in ways.items():
        fused[name] = fuse_runs(three_plan(redundant, given), signals)
        gain = best.G if given is None else given[np.newaxis]
        theory = float(covariances([world] * STEPS, [gain] * STEPS, [[0.0]])[-1].posterior[0, 0])
        errors = fused[name].error("x")[:, _SETTLED:]
        figures.append(rms_figure(f"error, {name}", errors, unit="m", expected=theory**0.5, slack=1e-4))
        nees = np.mean(errors**2 / fused[name].variance("x")[:, _SETTLED:], axis=1)
        figures.append(mean_figure(f"NEES, {name}", nees, expected=1.0))
    return Experiment(
        title="Fixed weights (eq. 29): one quantity, three sensors of sd 0.1, 0.2 and 0.4 m",
        text="The article has no numbers. With weights that add up to 1, as it asks for, the prediction has no "
        "influence; the optimal constants add up to 0.43. NEES is 1 where a filter knows its errors, which by Joseph's "
        "form it does for any gain.",
        figures=figures,
        pictures=[_picture(redundant, fused)],
    )


def _picture(redundant: Redundant, fused: dict[str, Runs]) -> Picture:
    shown = slice(0, 100)
    t = times(STEPS, redundant.dt)[shown]
    some = next(iter(fused.values()))
    z = next(one for one in some.signals[0] if one.topic == "/sensor/b").values[shown, 0]
    truth = some.truth()[0, shown]

    def estimate(way: str) -> Floats:
        return fused[way].estimate("x")[0, shown]

    track = [
        Line(label="sensor b", x=t, y=z, role="measured"),
        Line(label="truth", x=t, y=truth, role="truth"),
        Line(label="optimal weights", x=t, y=estimate("fixed weights that are optimal"), role="fused"),
        Line(label="weights 1/r, sum 1", x=t, y=estimate("weights 1/r, sum 1"), role="other"),
    ]
    errors = [
        Line(label="equal thirds", x=t, y=estimate("equal thirds") - truth, role="wrong"),
        Line(label="weights 1/r, sum 1", x=t, y=estimate("weights 1/r, sum 1") - truth, role="other"),
        Line(label="optimal weights", x=t, y=estimate("fixed weights that are optimal") - truth, role="fused"),
    ]
    return Picture(
        name="Fixed weights",
        panels=[Panel(x="t, s", y="x, m", lines=track), Panel(x="t, s", y="error, m", lines=errors)],
    )


def missing(runs: int, share: float = 0.3) -> Experiment:
    """Sensors that are missing: where their weights should go."""
    redundant = Redundant(missing=share)
    g = fixed_weights(redundant.sigma_w**2, redundant.sd**2)
    signals = simulate_runs(redundant_signals, redundant, STEPS * redundant.dt, max(50, runs // 5), seed=42)
    figures = [
        Figure(
            name="g/(1 − Σ of the missing) against the gain of those present",
            ours=_rescale_error(redundant, g),
            expected=0.0,
            slack=1e-12,
            note="largest difference over all ways to miss some",
        ),
        _rms_of(three_plan(redundant), signals, "error, optimal gain"),
    ]
    rules: dict[MissingRule, str] = {
        "rescale": "g/(1 − Σ of the missing)",
        "prediction": "missing share to the prediction",
        "renormalize": "missing share to the others",
    }
    figures += [
        _rms_of(three_plan(redundant, g, missing=rule), signals, f"error, {name}") for rule, name in rules.items()
    ]
    return Experiment(
        title=f"A sensor that is missing: each drops out {100 * share:g} % of the time",
        text="The article does not treat it. Of constants that are optimal together, the rule g/(1 − Σ) makes those "
        "that are optimal for the sensors that came at the same covariance, whatever R is.",
        figures=figures,
    )


def _rms_of(plan: Plan, signals: list[list[Signal]], name: str) -> Figure:
    return rms_figure(name, fuse_runs(plan, signals).error("x")[:, _SETTLED:], unit="m")


def _rescale_error(redundant: Redundant, g: Floats) -> float:
    r = redundant.sd**2
    world = make_step([[1.0]], [[redundant.sigma_w**2]], np.ones((3, 1)), np.diag(r))
    prior = riccati(world, STEPS, [[0.0]])[-1].prior
    worst = 0.0
    for here in np.indices((2, 2, 2)).reshape(3, -1).T.astype(bool)[1:]:
        some = make_step([[1.0]], [[0.0]], np.ones((int(here.sum()), 1)), np.diag(r[here]))
        worst = max(worst, float(np.abs(present_weights(g, here)[here] - optimal_gain(prior, some)[0]).max()))
    return worst


def prove_joseph() -> Proof:
    """E6: (26) with a gain that is not the optimal one: identity, symmetry, and NEES of fuselog's filter."""
    noise = np.random.default_rng(6)
    A, B = noise.standard_normal((3, 3)), noise.standard_normal((2, 2))
    prior, R = A @ A.T + np.eye(3), B @ B.T + np.eye(2)
    H, G = noise.standard_normal((2, 3)), noise.standard_normal((3, 2))
    step = make_step(np.eye(3), np.zeros((3, 3)), H, R)
    joseph = correct(prior, step, G)
    printed = (np.eye(3) - G @ H) @ prior
    K = optimal_gain(prior, step)
    numbers = {
        "P_J − P₂₆ − (G − K)SGᵀ": float(np.abs(joseph.posterior - printed - (G - K) @ joseph.S @ G.T).max()),
        "asymmetry of P₂₆": float(np.abs(printed - printed.T).max()),
    }
    nees: list[float] = []
    for g in (0.3, 0.02):
        q, r = 0.01, 1.0
        claimed = (1 - g) * q / g
        true = float(lyapunov([[1.0]], [[1.0]], [[q]], [[r]], [[g]]).posterior[0, 0])
        signals = simulate_runs(particle_signals, Particle(sigma_xi=0.1, sigma_eta=1.0), 50.0, 100, seed=61)
        gain = {"mode": "fixed", "form": "state", "weights": {"x": {"position.x": g}}}
        fused = fuse_runs(line_plan(sd=1.0, step=0.1, dt=0.1, start_sd=0.0, gain=gain), signals)
        squares = fused.error("x")[:, 250:] ** 2
        nees.append(float(np.mean(squares / fused.variance("x")[:, 250:])))
        numbers |= {f"P₂₆, g = {g:g}": claimed, f"P_J, g = {g:g}": true}
        numbers |= {
            f"NEES by P₂₆, g = {g:g}": float(np.mean(squares)) / claimed,
            f"NEES by fuselog, g = {g:g}": nees[-1],
        }
    holds = numbers["P_J − P₂₆ − (G − K)SGᵀ"] < 1e-12 and numbers["NEES by P₂₆, g = 0.3"] > 6
    return Proof(numbers=numbers, holds=holds and abs(nees[0] - 1) < 0.1)


def prove_nothing_left() -> Proof:
    """E6b: (26) with weights that add up to 1 and h = x, against what fuselog's filter says and finds."""
    w = inverse_variance(THREE.sd**2)
    prior = 0.05**2
    fused = fuse_runs(three_plan(THREE, w), simulate_runs(redundant_signals, THREE, 20.0, 20, seed=62))
    squares = fused.error("x") ** 2
    numbers = {
        "P by (26), m²": float((1 - w.sum()) * prior),
        "P by Joseph, m²": float(fused.variance("x")[0, -1]),
        "Σg²R, m²": float(np.sum(w**2 * THREE.sd**2)),
        "mean squared error, m²": float(np.mean(squares)),
    }
    zero, joseph, static, found = numbers.values()
    return Proof(
        numbers=numbers, holds=abs(zero) < 1e-15 and abs(joseph - static) < 1e-12 and abs(found / joseph - 1) < 0.1
    )


def prove_static() -> Proof:
    """E6c: one sample of each sensor, from five predictions, with weights that add up to 1."""
    w = inverse_variance(THREE.sd**2)
    signals = simulate_runs(redundant_signals, THREE, THREE.dt, 1, seed=63)
    z = np.array([one.values[0, 0] for one in signals[0] if one.topic.startswith("/sensor/")])
    starts = (-12.0, 0.0, 7.0, 40.0, 163.0)
    found = [float(fuse_runs(three_plan(THREE, w, start=start), signals).estimate("x")[0, -1]) for start in starts]
    numbers = {"weighted mean Σgz, m": float(w @ z), "spread of estimates from −12 … 163, m": max(found) - min(found)}
    numbers["difference from the mean, m"] = max(abs(one - float(w @ z)) for one in found)
    return Proof(numbers=numbers, holds=numbers["difference from the mean, m"] < 1e-12)


def prove_units() -> Proof:
    """E6d: (29) for h = c x with a weight of 1: by what an error of the estimate is multiplied."""
    numbers = {f"factor for h = {c:g}·x": 1 - c for c in (0.01, 1.0, 2.0, 2.5)}
    return Proof(numbers=numbers, holds=abs(numbers["factor for h = 2.5·x"]) > 1)


def prove_angles() -> Proof:
    """E6e: two sensors of a heading that say 179 and -179 degrees; the mean (30), and fuselog's filter."""
    t_ns = stamps(np.array([0.0, 0.1]))
    said = np.deg2rad([179.0, -179.0])
    signals: list[Signal] = [reading("/ground_truth", t_ns, {"yaw": np.full(2, np.pi)})]
    signals += [reading(f"/yaw/{name}", t_ns[1:], {"yaw": said[i : i + 1]}) for i, name in enumerate("ab")]
    yaw = {"fuse": ["yaw"], "fields": {"yaw": "values[0]"}, "noise": {"yaw": 0.1}}
    distance = {"topic": "/wall/distance", "fuse": ["y"], "fields": {"y": "values[0]"}, "noise": {"y": 0.1}}
    plan = plan_of(
        model={"name": "wall_follower"},
        initial={"state": {"y": 0.0, "yaw": 3.0}},
        gain={
            "mode": "fixed",
            "form": "state",
            "weights": {"yaw": {"a.yaw": 0.5, "b.yaw": 0.5}, "y": {"distance.y": 0.5}},
        },
        sensors={
            "distance": {**distance, "mount": {"xyz": [0.1, 0, 0]}},
            **{name: {"topic": f"/yaw/{name}", **yaw} for name in "ab"},
        },
    )
    found = float(fuse_runs(plan, [signals]).estimate("yaw")[0, -1])
    numbers = {"mean (30), °": float(np.rad2deg(said.mean())), "fuselog, °": abs(float(np.rad2deg(found)))}
    return Proof(numbers=numbers, holds=abs(numbers["fuselog, °"] - 180) < 1e-9)


def prove_zero() -> Proof:
    """E8: P0 = 0 and Q = 0: the gains of 100 samples of a constant, and the same from P0 = 1."""
    step = make_step([[1.0]], [[0.0]], [[1.0]], [[1.0]])
    sums = [sum(float(one.G[0, 0]) for one in riccati(step, 100, [[P0]])) for P0 in (0.0, 1.0)]
    numbers = {"sum of gains from P = 0": sums[0], "sum of gains from P = 1": sums[1]}
    numbers["states frozen for ever"] = float(len(frozen_states([[1.0]], [[0.0]], [[0.0]])))
    return Proof(numbers=numbers, holds=sums[0] == 0 and numbers["states frozen for ever"] == 1)


def prove_order() -> Proof:
    """E9: the range to a point 4 m to the side, 10 m/s and 0.1 s: h at the last estimate and at the prediction."""
    last, predicted = np.hypot(3.0, 4.0), np.hypot(4.0, 4.0)
    numbers = {"false innovation with h at x̂(k−1|k−1), m": float(predicted - last)}
    return Proof(numbers=numbers, holds=numbers["false innovation with h at x̂(k−1|k−1), m"] > 0.5)


def prove_sizes() -> Proof:
    """E9b: two states and one sensor, m < n: what matters is that every mode is seen."""
    F = [[1.0, 0.1], [0.0, 1.0]]
    numbers = {
        "unseen modes, position measured": float(len(undetectable_modes(F, [[1.0, 0.0]]))),
        "unseen modes, velocity measured": float(len(undetectable_modes(F, [[0.0, 1.0]]))),
    }
    seen, unseen = numbers.values()
    return Proof(numbers=numbers, holds=seen == 0 < unseen)


ERRATA = (
    Erratum(
        id="E6",
        where="eq. (26) with the weights of (29)",
        printed="P = (I − GH) P⁻",
        correct="P = (I − GH) P⁻ (I − GH)ᵀ + GRGᵀ. (26) holds for the optimal gain only, as is said below (14).",
        prove=prove_joseph,
    ),
    Erratum(
        id="E6b",
        where="eq. (26), weights that add up to 1",
        printed="P = (1 − Σg) P⁻",
        correct="With h = x this is 0: a filter that believes itself to be exact.",
        prove=prove_nothing_left,
    ),
    Erratum(
        id="E6c",
        where="eq. (29), (30)",
        printed="Σg = 1",
        correct="Σg < 1 to use the model: with 1, (29) is the weighted mean (30), and f, Q, P have no effect.",
        prove=prove_static,
    ),
    Erratum(
        id="E6d",
        where="eq. (29) for h other than x",
        printed="weights from 0 to 1",
        correct="A weight has a unit where h has a slope: g divided by ∂h/∂x, or shares of the innovation.",
        prove=prove_units,
    ),
    Erratum(
        id="E6e",
        where="eq. (30) for angles",
        printed="K = Σ g z",
        correct="Always by innovations, wrapped.",
        prove=prove_angles,
    ),
    Erratum(
        id="E8",
        where="initial arrays of zeros",
        printed="P = 0",
        correct="P of what is not known; where Q is singular too, the state is never corrected.",
        prove=prove_zero,
    ),
    Erratum(
        id="E9",
        where="the cycle of seven operations",
        printed="h and its Jacobian before f; x̂(k|k−1) in no operation",
        correct="f and its Jacobian, x̂(k|k−1), P(k|k−1), h and its Jacobian there, z, G, x̂(k|k), P(k|k).",
        prove=prove_order,
    ),
    Erratum(
        id="E9b",
        where="conditions; (1)-(4), (24)",
        printed="n < m is needed for fusion; u(k) and u(k − 1), Q(k) and Q(k − 1) mixed; no Σ in (29)",
        correct="What is needed is that every mode is seen; the cost is O(n³) in the states, not in the data.",
        prove=prove_sizes,
    ),
)
