"""Melnikov: the stone thrown up, with the step that is printed and the right one."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.design import make_step, steady_scalar_gain
from fuselog.replay.articles.line import line_plan, measured
from fuselog.replay.articles.result import Erratum, Experiment, Figure, Line, Panel, Picture, Proof, rms_figure
from fuselog.replay.articles.runs import Runs, fuse_runs, simulate_runs, times
from fuselog.replay.articles.theory import riccati
from fuselog.replay.scenarios.melnikov import DT, Stone, stone_signals, throw
from fuselog.replay.signals import Signal

Floats = NDArray[np.float64]

STONE = Stone()
STEPS = 400  # until a bias has settled, wherever the ground may be
_SHOWN = 80
PRINTED, RIGHT = 404.9, 395.1  # m, of the step at t = 0


def stone(runs: int, thrown: Stone = STONE) -> Experiment:
    """The filter with the right step and with the printed one, which an offset of the known velocity makes."""
    signals = simulate_runs(stone_signals, thrown, STEPS * DT, runs, seed=51)
    right, printed = (_fuse(thrown, signals, off) for off in (0.0, (PRINTED - RIGHT) / DT))
    bias, variance = _theory(thrown)
    figures = [
        Figure(
            name="gain it settles at",
            ours=float(right.absorbed("position")[-1]),
            expected=steady_scalar_gain(thrown.sigma_e**2, thrown.sigma_n**2),
            slack=1e-6,
        ),
        Figure(
            name="E(e²) against the formula that the text breaks off before",
            ours=_worst(thrown, right),
            expected=0.0,
            slack=1e-12,
            note="largest relative difference over 400 steps: E(e²)' = δN²(E(e²) + δE²)/(E(e²) + δE² + δN²)",
        ),
        rms_figure("error at t = 400 with 395.1", right.error("x")[:, -1:], unit="m", expected=variance**0.5),
        rms_figure(
            "error at t = 400 with 404.9",
            printed.error("x")[:, -1:],
            unit="m",
            expected=float(np.hypot(bias, variance**0.5)),
            note="as printed",
        ),
    ]
    return Experiment(
        title="The stone: height measured, δE = 1 m, δN = 50 m",
        text="The article has no numbers, and ends before its last formula; the deviations are ours.",
        figures=figures,
        pictures=[_picture(right, printed)],
    )


def _fuse(thrown: Stone, signals: list[list[Signal]], offset: float) -> Runs:
    return fuse_runs(line_plan(sd=thrown.sigma_n, step=thrown.sigma_e, dt=DT, offset=offset), signals)


def _theory(thrown: Stone) -> tuple[float, float]:
    """The bias (m) that the printed step leaves after ``STEPS``, and the variance (m²)."""
    step = make_step([[1.0]], [[thrown.sigma_e**2]], [[1.0]], [[thrown.sigma_n**2]])
    cycles = riccati(step, STEPS, [[0.0]])
    bias = 0.0
    for cycle in cycles:
        bias = (1 - float(cycle.G[0, 0])) * (bias + PRINTED - RIGHT)
    return bias, float(cycles[-1].posterior[0, 0])


def _worst(thrown: Stone, fused: Runs) -> float:
    """How far the filter's variances are from the missing formula, relative to them."""
    found = fused.variance("x")[0]
    prior = np.concatenate([[0.0], found[:-1]]) + thrown.sigma_e**2
    formula = thrown.sigma_n**2 * prior / (prior + thrown.sigma_n**2)
    return float(np.max(np.abs(found / formula - 1)))


def _picture(right: Runs, printed: Runs) -> Picture:
    t = times(_SHOWN, DT)
    truth, z = right.truth()[0, :_SHOWN], measured(right)[0, :_SHOWN]
    found, wrong = right.estimate("x")[0, :_SHOWN], printed.estimate("x")[0, :_SHOWN]
    height = [
        Line(label="measured", x=t, y=z, role="measured"),
        Line(label="truth", x=t, y=truth, role="truth"),
        Line(label="filter, 395.1", x=t, y=found, role="fused"),
        Line(label="filter, 404.9", x=t, y=wrong, role="wrong"),
    ]
    errors = [
        Line(label="measured", x=t, y=z - truth, role="measured"),
        Line(label="filter, 395.1", x=t, y=found - truth, role="fused"),
        Line(label="filter, 404.9", x=t, y=wrong - truth, role="wrong"),
    ]
    return Picture(
        name="Stone",
        panels=[Panel(x="t, s", y="height, m", lines=height), Panel(x="t, s", y="error, m", lines=errors)],
    )


def prove_step() -> Proof:
    """E5: a step of the undisturbed stone, and the bias that the printed one leaves in the filter."""
    still = throw(replace(STONE, sigma_e=0.0), 4, np.random.default_rng(0)).x
    step = float(still[4] - still[3]) + STONE.gravity * 3
    numbers = {"x₄ − x₃ + 9.8·3, m": step}
    for sigma_e, sigma_n in ((1.0, 50.0), (5.0, 20.0)):
        K = steady_scalar_gain(sigma_e**2, sigma_n**2)
        numbers[f"bias with δE = {sigma_e:g}, δN = {sigma_n:g}, m"] = (PRINTED - RIGHT) * (1 - K) / K
    return Proof(numbers=numbers, holds=abs(step - RIGHT) < 1e-9)


def prove_double() -> Proof:
    """E5b: e of the third line, which takes K x off twice, against its definition x - x_opt."""
    x, noise, predicted, K = 1000.0, 20.0, 970.0, 0.3
    e = x - (K * (x + noise) + (1 - K) * predicted)
    printed = x * (1 - K) - K * (x + noise) - (1 - K) * predicted
    right = x * (1 - K) - K * noise - (1 - K) * predicted
    numbers = {"off as printed, m": printed - e, "−Kx, m": -K * x, "off without it, m": right - e}
    return Proof(numbers=numbers, holds=abs(printed - e + K * x) < 1e-9 and abs(right - e) < 1e-9)


ERRATA = (
    Erratum(
        id="E5",
        where="the step of x",
        printed="x' = x + at + 404.9",
        correct="x' = x + at + 395.1 (400 − 4.9). With 404.9 the filter is off by 9.8(1 − K)/K.",
        prove=prove_step,
    ),
    Erratum(
        id="E5b",
        where="e at t + 1, third line",
        printed="x(1 − K) − K(x + N)",
        correct="x(1 − K) − KN; D(N) is that of t + 1.",
        prove=prove_double,
    ),
)
