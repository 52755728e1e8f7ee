"""Alymov 2023: a position with a known velocity, and with an unknown one."""

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.fusion.design import make_step
from fuselog.replay.articles.line import line_plan, measured
from fuselog.replay.articles.result import Erratum, Experiment, Figure, Line, Panel, Picture, Proof, mean_figure
from fuselog.replay.articles.runs import Runs, fuse_runs, plan_of, simulate_runs, times
from fuselog.replay.articles.theory import moments, riccati
from fuselog.replay.scenarios.alymov import Mover, mover_signals
from fuselog.replay.scenarios.line import Particle, particle_signals

Floats = NDArray[np.float64]

STEPS = 101
PUBLISHED_RUNS = 1  # an article of a single run, without a seed
ONE_D = Particle(sigma_xi=0.0, sigma_eta=13.5**0.5, dt=1.0)
TWO_D = Mover()
_ASSUMED_R, _ASSUMED_A = 10.0, 0.1  # m², m²/s⁴: ours, for the article's are lost


def one_d(runs: int, particle: Particle = ONE_D) -> Experiment:
    """The filter as the notebook builds it, with Q = R = P = 1; as it declares it; and as the world is."""
    signals = simulate_runs(particle_signals, particle, STEPS * particle.dt, runs, seed=31)
    executed = fuse_runs(line_plan(sd=1.0, step=1.0, dt=particle.dt, start_sd=1.0), signals)
    declared = fuse_runs(line_plan(sd=3.0, step=0.1**0.5, dt=particle.dt, start_sd=1.0), signals)
    world = make_step([[1.0]], [[particle.sigma_xi**2]], [[1.0]], [[particle.sigma_eta**2]])

    def theory(Q: float, R: float) -> float:
        steps = riccati(make_step([[1.0]], [[Q]], [[1.0]], [[R]]), STEPS, [[1.0]])
        return float(np.mean(moments(world, [one.G for one in steps], [[0.0]])))

    raw = measured(executed) - executed.truth()
    figures = [
        mean_figure(
            "1D, filter",
            np.mean(executed.error("x") ** 2, axis=1),
            unit="m²",
            printed="6.445225374768028",
            printed_runs=PUBLISHED_RUNS,
            expected=theory(1.0, 1.0),
            note="published is one run; ours a mean",
        ),
        mean_figure(
            "1D, sensor alone",
            np.mean(raw**2, axis=1),
            unit="m²",
            printed="13.662836949233665",
            printed_runs=PUBLISHED_RUNS,
            expected=particle.sigma_eta**2,
        ),
        Figure(
            name="1D, gain it settles at",
            ours=float(executed.absorbed("position")[-1]),
            expected=(5**0.5 - 1) / 2,
            slack=1e-9,
            note="the golden ratio, for Q = R",
        ),
        mean_figure(
            "1D, filter with the declared Q = 0.1, R = 9",
            np.mean(declared.error("x") ** 2, axis=1),
            unit="m²",
            expected=theory(0.1, 9.0),
            note="what the article would have had: its filter runs with the defaults",
        ),
    ]
    return Experiment(
        title="1D: position with a known velocity",
        text="Mean squared errors over 101 points. The notebook declares Q and R but builds the filter with its "
        "defaults, 1; the noise has variance 13.5.",
        figures=figures,
        pictures=[_picture("1D", executed, particle.dt)],
    )


def _picture(name: str, fused: Runs, dt: float) -> Picture:
    t = times(STEPS, dt)
    truth, z, estimate = fused.truth()[0], measured(fused)[0], fused.estimate("x")[0]
    position = [
        Line(label="measured", x=t, y=z, role="measured"),
        Line(label="truth", x=t, y=truth, role="truth"),
        Line(label="filter", x=t, y=estimate, role="fused"),
    ]
    errors = [
        Line(label="measured", x=t, y=z - truth, role="measured"),
        Line(label="filter", x=t, y=estimate - truth, role="fused"),
    ]
    return Picture(
        name=name, panels=[Panel(x="t, s", y="x, m", lines=position), Panel(x="t, s", y="error, m", lines=errors)]
    )


def two_d(runs: int, mover: Mover = TWO_D) -> Experiment:
    """Position and velocity: the published errors with settings that fit them."""
    Q = _ASSUMED_A * np.array([[mover.dt**4 / 4, mover.dt**3 / 2], [mover.dt**3 / 2, mover.dt**2]])
    fused = fuse_runs(_mover_plan(Q), simulate_runs(mover_signals, mover, STEPS * mover.dt, runs, seed=32))
    expected = _two_d_theory(mover, Q)
    raw = measured(fused) - fused.truth()
    figures = [
        mean_figure(
            "2D, filter",
            np.mean(fused.error("x") ** 2, axis=1),
            unit="m²",
            printed="4.373575084042279",
            printed_runs=PUBLISHED_RUNS,
            expected=expected,
            note="R = 10, variance of acceleration 0.1, v = 0 at the start: ours, the article's are lost",
        ),
        mean_figure(
            "2D, sensor alone",
            np.mean(raw**2, axis=1),
            unit="m²",
            printed="15.774612573664305",
            printed_runs=PUBLISHED_RUNS,
            expected=mover.sigma_eta**2,
        ),
    ]
    return Experiment(
        title="2D: position and unknown velocity",
        text="The settings behind the published numbers are neither in the article nor in its notebooks. These are of "
        "a family that fits both numbers.",
        figures=figures,
        pictures=[_picture("2D", fused, mover.dt)],
    )


def _two_d_theory(mover: Mover, Q: Floats) -> float:
    """The expected squared error: from v = 0, which is wrong, at the first sample, where the filter starts."""
    F, H = np.array([[1.0, mover.dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    still, nothing = np.eye(2), np.zeros((2, 2))
    first = riccati(make_step(still, nothing, H, [[_ASSUMED_R]]), 1, np.diag(np.diag(Q)))[0]
    later = riccati(make_step(F, Q, H, [[_ASSUMED_R]]), STEPS - 1, first.posterior)
    off = np.array([mover.v * mover.dt, mover.v])
    noise = [[mover.sigma_eta**2]]
    begun = moments(make_step(still, nothing, H, noise), [first.G], np.outer(off, off))
    going = moments(make_step(F, nothing, H, noise), [one.G for one in later], begun[0])
    return float(np.mean(np.concatenate([begun, going])[:, 0, 0]))


def _mover_plan(P0: Floats) -> Plan:
    position = {"topic": "/sensor/position", "fuse": ["x"], "fields": {"x": "values[0]"}}
    return plan_of(
        model={"name": "models.py:pushed", "process_noise": {"a": _ASSUMED_A}},
        initial={
            "state": {"x": 0.0, "v": 0.0},
            "sd": dict(zip(("x", "v"), np.sqrt(np.diag(P0)).tolist(), strict=True)),
        },
        sensors={"position": {**position, "noise": {"x": _ASSUMED_R**0.5}}},
    )


def prove_covariance() -> Proof:
    """E2: P = P- + R in place of (1 - K) P-, ten steps with Q = 0.1, R = 9 from P = 1."""
    Q, R = 0.1, 9.0
    variance, gain = 1.0, 0.0
    for _ in range(10):
        prior = variance + Q
        gain = prior / (prior + R)
        variance = prior + R
    right = riccati(make_step([[1.0]], [[Q]], [[1.0]], [[R]]), 10, [[1.0]])[-1]
    numbers = {
        "P printed": variance,
        "P right": float(right.posterior[0, 0]),
        "K printed": gain,
        "K right": float(right.G[0, 0]),
    }
    return Proof(numbers=numbers, holds=variance > 50 * numbers["P right"])


def prove_order() -> Proof:
    """E2b: the sizes of HK and KH for two states and one measurement."""
    H, K = np.ones((1, 2)), np.ones((2, 1))
    numbers = {"rows of HK": float((H @ K).shape[0]), "rows of KH": float((K @ H).shape[0]), "rows of P": 2.0}
    return Proof(numbers=numbers, holds=numbers["rows of KH"] == numbers["rows of P"] != numbers["rows of HK"])


ERRATA = (
    Erratum(
        id="E2",
        where="P_k, σ_k² of the derivation",
        printed="P = P̄ + R, σ² = σ̄² + σ_η²",
        correct="P = (1 − K) P̄: a measurement makes the variance smaller. The notebook has it right.",
        prove=prove_covariance,
    ),
    Erratum(
        id="E2b",
        where="table of the filter",
        printed="P = (I − HK) P̄, index k + 1",
        correct="P = (I − KH) P̄, index k.",
        prove=prove_order,
    ),
    Erratum(
        id="E2c",
        where="text",
        printed="v is a position; total probability without its index j; Bayes' formula twice",
        correct="v is a velocity; a sum over j.",
    ),
)
