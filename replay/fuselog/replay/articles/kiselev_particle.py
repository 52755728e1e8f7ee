"""Kiselev 2020, chapter 1: the Brownian particle with a known drift, and with one that is controlled."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.design import lyapunov, make_step, steady_scalar_gain
from fuselog.replay.articles.line import line_plan, measured
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
from fuselog.replay.articles.runs import Runs, fuse_runs, simulate_runs, times
from fuselog.replay.articles.theory import riccati, rms
from fuselog.replay.scenarios.kiselev_particle import drift_signals
from fuselog.replay.scenarios.line import Particle, particle_signals

Floats = NDArray[np.float64]

STEPS = 49  # between the 50 points of a picture
PUBLISHED_RUNS = 1000
FIGURE_4, FIGURE_5 = Particle(), Particle(sigma_xi=0.2, sigma_eta=0.02)
FIGURE_6 = Particle(sigma_xi=0.2, sigma_eta=0.02, v=0.1)


def figure_4(runs: int, particle: Particle = FIGURE_4) -> Experiment:
    """A model better than the sensor."""
    return _known_drift("Fig. 4", particle, runs, printed=("0.1", "0.0162", "0.115"), seed=4)


def figure_5(runs: int, particle: Particle = FIGURE_5) -> Experiment:
    """A sensor better than the model."""
    return _known_drift("Fig. 5", particle, runs, printed=("0.99", "0.002", "0.156"), seed=5)


def _known_drift(name: str, particle: Particle, runs: int, *, printed: tuple[str, str, str], seed: int) -> Experiment:
    plan = line_plan(sd=particle.sigma_eta, step=particle.sigma_xi, dt=particle.dt)
    fused = fuse_runs(plan, simulate_runs(particle_signals, particle, STEPS * particle.dt, runs, seed=seed))
    average = moving_average(measured(fused))
    k = steady_scalar_gain(particle.sigma_xi**2, particle.sigma_eta**2)
    step = make_step([[1.0]], [[particle.sigma_xi**2]], [[1.0]], [[particle.sigma_eta**2]])
    filtered = sum(float(one.posterior[0, 0]) for one in riccati(step, STEPS, [[0.0]])) * particle.dt
    gain, of_filter, of_average = printed
    figures = [
        Figure(
            name=f"{name}, gain it settles at",
            printed=gain,
            ours=float(fused.absorbed("position")[-1]),
            expected=k,
            slack=1e-3 * k,
        ),
        mean_figure(
            f"{name}, filter",
            _integral(fused.error("x"), particle.dt),
            unit="m²s",
            printed=of_filter,
            printed_runs=PUBLISHED_RUNS,
            expected=filtered,
        ),
        mean_figure(
            f"{name}, moving average",
            _integral(average - fused.truth(), particle.dt),
            unit="m²s",
            printed=of_average,
            printed_runs=PUBLISHED_RUNS,
            expected=average_theory(particle),
        ),
    ]
    return Experiment(
        title=f"{name}: particle with a known drift, σξ = {particle.sigma_xi:g} m, ση = {particle.sigma_eta:g} m",
        text="The errors are sums over 50 points of squared error times dt; the article says sums, but its numbers are "
        "ten times smaller (dt = 0.1 s). The moving average is that of the last three measurements.",
        figures=figures,
        pictures=[_picture(name, fused, average, particle.dt)],
    )


def _integral(errors: Floats, dt: float) -> Floats:
    """The sum of squared errors (runs, n) times dt, run by run; the start, which is known, adds nothing."""
    return np.sum(errors**2, axis=1) * dt


def moving_average(z: Floats) -> Floats:
    """Of the last three points (runs, n), the first of all being the known start, 0."""
    points = np.pad(z, ((0, 0), (1, 0)))
    return np.stack([points[:, max(0, i - 2) : i + 1].mean(axis=1) for i in range(1, points.shape[1])], axis=1)


def average_theory(particle: Particle) -> float:
    """The expected integral of the squared error of ``moving_average``: noise, and a lag behind drift and walk."""
    drift, walk, noise = (particle.v * particle.dt) ** 2, particle.sigma_xi**2, particle.sigma_eta**2
    first = (drift + walk + noise) / 4
    second = drift + (5 * walk + 2 * noise) / 9
    later = drift + (5 * walk + 3 * noise) / 9
    return (first + second + (STEPS - 2) * later) * particle.dt


def _picture(name: str, fused: Runs, average: Floats, dt: float) -> Picture:
    t = times(STEPS, dt)
    truth, z, estimate = fused.truth()[0], measured(fused)[0], fused.estimate("x")[0]
    return Picture(
        name=name,
        panels=[
            Panel(
                x="t, s",
                y="x, m",
                lines=[
                    Line(label="measured", x=t, y=z, role="measured"),
                    Line(label="truth", x=t, y=truth, role="truth"),
                    Line(label="moving average", x=t, y=average[0], role="other"),
                    Line(label="filter", x=t, y=estimate, role="fused"),
                ],
            ),
            Panel(
                x="t, s",
                y="error, m",
                lines=[
                    Line(label="measured", x=t, y=z - truth, role="measured"),
                    Line(label="moving average", x=t, y=average[0] - truth, role="other"),
                    Line(label="filter", x=t, y=estimate - truth, role="fused"),
                ],
            ),
        ],
    )


def figure_6(runs: int, particle: Particle = FIGURE_6) -> Experiment:
    """The article's control of the drift, and the filter that watches it."""
    fused = fuse_runs(
        line_plan(sd=particle.sigma_eta, step=particle.sigma_xi, dt=particle.dt),
        simulate_runs(drift_signals, particle, STEPS * particle.dt, runs, seed=6),
    )
    t = times(STEPS, particle.dt)
    away = fused.truth() - particle.v * t
    averaged = follow_with_average(particle, runs)
    step = make_step([[1.0]], [[particle.sigma_xi**2]], [[1.0]], [[particle.sigma_eta**2]])
    figures = [
        mean_figure(
            "Fig. 6, filter",
            _integral(away, particle.dt),
            unit="m²s",
            printed="0.245",
            printed_runs=PUBLISHED_RUNS,
            expected=_control_theory(particle),
            note="the law as printed: the prediction starts at the true place",
        ),
        mean_figure(
            "Fig. 6, moving average",
            _integral(averaged, particle.dt),
            unit="m²s",
            printed="4.233",
            reproducible=False,
            note="the article does not say how the average steers; this one takes back its distance from v0 t",
        ),
        rms_figure(
            "Fig. 6, estimate of fuselog's filter",
            fused.error("x"),
            unit="m",
            expected=rms(np.array([one.posterior[0, 0] for one in riccati(step, STEPS, [[0.0]])])),
            note="it watches the loop",
        ),
    ]
    picture = Picture(
        name="Fig. 6",
        panels=[
            Panel(
                x="t, s",
                y="x, m",
                lines=[
                    Line(label="wanted", x=t, y=particle.v * t, role="other"),
                    Line(label="truth", x=t, y=fused.truth()[0], role="truth"),
                    Line(label="filter", x=t, y=fused.estimate("x")[0], role="fused"),
                ],
            )
        ],
    )
    return Experiment(
        title="Fig. 6: particle whose drift is controlled, σξ = 0.2 m, ση = 0.02 m",
        text="Sums over the points of the squared distance from v0 t, times dt.",
        figures=figures,
        pictures=[picture],
    )


def _constant(particle: Particle) -> float:
    """The gain of 1.7, as if the last place had been known."""
    return particle.sigma_xi**2 / (particle.sigma_xi**2 + particle.sigma_eta**2)


def _control_theory(particle: Particle) -> float:
    """d' = d + xi - k (xi + eta) of the step before: E[d^2] = sxi^2 + (i - 1) k seta^2 after i steps."""
    i = np.arange(1, STEPS + 1)
    variance = particle.sigma_xi**2 + (i - 1) * _constant(particle) * particle.sigma_eta**2
    return float(np.sum(variance) * particle.dt)


def follow_with_average(particle: Particle, runs: int) -> Floats:
    """Distances (runs, n) from v0 t where each step takes back what the moving average says that it is."""
    noise = np.random.default_rng(63)
    away, seen = np.zeros((runs, STEPS + 1)), np.zeros((runs, STEPS + 1))
    for i in range(STEPS):
        step = -seen[:, max(0, i - 2) : i + 1].mean(axis=1)
        away[:, i + 1] = away[:, i] + step + particle.sigma_xi * noise.standard_normal(runs)
        seen[:, i + 1] = away[:, i + 1] + particle.sigma_eta * noise.standard_normal(runs)
    return away[:, 1:]


def prove_squares() -> Proof:
    """E1: with sigma_xi in the gain in place of its square."""
    numbers: dict[str, float] = {}
    holds = True
    for xi, eta in ((0.02, 0.2), (0.2, 0.02), (0.1, 0.2)):
        printed, right = settle_as_printed(xi, eta), steady_scalar_gain(xi**2, eta**2)
        wrong_rms, right_rms = (
            float(lyapunov([[1.0]], [[1.0]], [[xi**2]], [[eta**2]], [[k]]).posterior[0, 0]) ** 0.5
            for k in (printed, right)
        )
        at = f"({xi:g}, {eta:g})"
        numbers |= {f"k printed {at}": printed, f"k right {at}": right}
        numbers |= {f"RMSE printed {at}": wrong_rms, f"RMSE right {at}": right_rms}
        holds = holds and wrong_rms > right_rms
    return Proof(numbers=numbers, holds=holds and numbers["k printed (0.2, 0.02)"] > 1)


def settle_as_printed(xi: float, eta: float) -> float:
    """Where k = (s² + sxi) / (s² + sxi² + seta²) settles, sxi standing where its square should."""
    variance, k = 0.0, 0.0
    for _ in range(1000):
        k = (variance + xi) / (variance + xi**2 + eta**2)
        variance = (1 - k) ** 2 * (variance + xi**2) + k**2 * eta**2
    return k


def prove_control() -> Proof:
    """E12: the constant gain, which must start at its own estimate, against fuselog's filter on the same loop."""
    numbers: dict[str, float] = {}
    for xi, eta in ((0.2, 0.02), (0.02, 0.2)):
        particle = replace(FIGURE_6, sigma_xi=xi, sigma_eta=eta)
        constant = lyapunov([[1.0]], [[1.0]], [[xi**2]], [[eta**2]], [[_constant(particle)]])
        plan = line_plan(sd=eta, step=xi, dt=particle.dt)
        fused = fuse_runs(plan, simulate_runs(drift_signals, particle, 40.0, 20, seed=12))
        numbers[f"RMSE constant ({xi:g}, {eta:g})"] = float(constant.posterior[0, 0]) ** 0.5
        numbers[f"RMSE recursion ({xi:g}, {eta:g})"] = rms(fused.error("x") ** 2)
    apart = numbers["RMSE constant (0.02, 0.2)"] / numbers["RMSE recursion (0.02, 0.2)"]
    return Proof(numbers=numbers, holds=apart > 2)


ERRATA = (
    Erratum(
        id="E1",
        where="1.4 and eq. (11)",
        printed="k = (σᵢ² + σξ) / (σᵢ² + σξ² + ση²)",
        correct="σξ² in the numerator. With the slip k may exceed 1; gains of 0.1 and 0.99 need the square. "
        "Numbers are for (σξ, ση).",
        prove=prove_squares,
    ),
    Erratum(
        id="E12",
        where="1.7",
        printed="x̂ starts at the true x; k = σξ²/(σξ² + ση²)",
        correct="A filter starts at its own estimate, and needs the recursion of 1.4: control does not change "
        "estimation. Also x̃ where ỹ is printed. Numbers are for (σξ, ση).",
        prove=prove_control,
    ),
    Erratum(
        id="E13",
        where="1.3, 1.4, captions",
        printed="(k − 1) as trust in the model; ξ₂ without its square; sign of 2k(1 − k)M[ξη]; “variance σ”",
        correct="(1 − k); M[ξ₂²]; the product has mean 0 with either sign; σ is a standard deviation.",
    ),
)
