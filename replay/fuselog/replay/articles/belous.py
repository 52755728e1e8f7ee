"""Belous, Belov 2019: the linear system with every kind of H, and the nonlinear one that the EKF is for."""

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.fusion.design import make_step, van_loan
from fuselog.replay.articles.result import (
    Erratum,
    Experiment,
    Line,
    Panel,
    Picture,
    Proof,
    mean_figure,
    rms_figure,
)
from fuselog.replay.articles.runs import Runs, fuse_runs, plan_of, simulate_runs, times
from fuselog.replay.articles.theory import riccati, rms
from fuselog.replay.scenarios.belous import (
    COMBINATION,
    SCALING,
    SELECTION,
    Circling,
    Linear,
    circle,
    discrete,
    linear_signals,
    nonlinear_signals,
)
from fuselog.replay.scenarios.planar import arc
from fuselog.replay.signals import Signal

Floats = NDArray[np.float64]

_EXACT = 1e-9
_LINEAR_S, _CIRCLE_S = 20.0, 60.0  # s, of a run
_SHARE = 20  # of these systems a run is long: one in so many is enough
_SLACK = 0.05  # of a consistency, for the linearisation


def linear_plan(linear: Linear) -> Plan:
    """Selection, scaling (a diameter is two radii) and combination (the perimeter) of the states."""
    names, paths = ("side_a", "side_b", "growth"), ("values[0]", "values[1]", "values[2]")
    return plan_of(
        model={
            "name": "models.py:growing",
            "process_noise": {"length": linear.q_length, "growth": linear.q_growth},
            "parameters": {"tau": linear.tau},
        },
        initial={
            "state": {"side_a": 3.0, "side_b": 4.0, "perimeter": 12.0, "radius": 1.0, "growth": 0.0},
            "sd": dict.fromkeys(("side_a", "side_b", "perimeter", "radius", "growth"), _EXACT),
        },
        sensors={
            "drive": {"topic": "/input/growth", "kind": "input", "fields": {"u": "values[0]"}, "noise": {"u": _EXACT}},
            "selection": {
                "topic": "/sensor/selection",
                "fuse": list(names),
                "fields": dict(zip(names, paths, strict=True)),
                "noise": dict(zip(names, linear.selection_sd.tolist(), strict=True)),
            },
            "diameter": {
                "topic": "/sensor/diameter",
                "fuse": ["radius"],
                "fields": {"radius": "values[0]"},
                "scale": {"radius": 0.5},
                "noise": {"radius": linear.diameter_sd / 2},
            },
            "perimeter": {
                "topic": "/sensor/perimeter",
                "fuse": ["perimeter"],
                "fields": {"perimeter": "values[0]"},
                "noise": {"perimeter": linear.perimeter_sd},
            },
        },
    )


def linear_system(runs: int, linear: Linear | None = None) -> Experiment:
    """All three kinds of H at once, through a model of its own."""
    linear = linear or Linear()
    n = round(_LINEAR_S / linear.dt)
    signals = simulate_runs(linear_signals, linear, _LINEAR_S, _few(runs), seed=21)
    fused = fuse_runs(linear_plan(linear), signals)
    a, b, c, radius, growth = (fused.truth(i) for i in range(5))
    errors = {
        "side_a": fused.estimate("side_a") - a,
        "side_b": fused.estimate("side_b") - b,
        "perimeter": fused.estimate("perimeter") - (a + b + c),
        "radius": fused.estimate("radius") - radius,
        "growth": fused.estimate("growth") - growth,
    }
    shown = {
        "a side, by selection": ("m", errors["side_a"], np.array([1.0, 0, 0, 0, 0])),
        "the third side, by the perimeter": (
            "m",
            errors["perimeter"] - errors["side_a"] - errors["side_b"],
            np.array([0, 0, 1.0, 0, 0]),
        ),
        "the radius, by the diameter": ("m", errors["radius"], np.array([0, 0, 0, 1.0, 0])),
        "growth, by selection": ("m/s", errors["growth"], np.array([0, 0, 0, 0, 1.0])),
    }
    F, _, Q = discrete(linear)
    R = np.diag([*linear.selection_sd, linear.diameter_sd, linear.perimeter_sd]) ** 2
    H = np.concatenate([SELECTION, SCALING, COMBINATION])
    P = np.stack([one.posterior for one in riccati(make_step(F, Q, H, R), n, np.zeros((5, 5)))])
    figures = [
        rms_figure(f"error of {name}", error, unit=unit, expected=rms(np.einsum("i,nij,j->n", pick, P, pick)))
        for name, (unit, error, pick) in shown.items()
    ]
    nees = np.mean(fused.nees(tuple(errors), list(errors.values())), axis=1)
    figures.append(mean_figure("NEES of five states", nees, expected=5.0))
    t = times(n, linear.dt)
    return Experiment(
        title="Linear: selection, scaling and combination of states (eq. 1-17)",
        text="The article has no numbers. Theory is the covariance recursion with the exact F and Q in place of (12) "
        "and (13).",
        figures=figures,
        pictures=[_linear_picture(t, fused, c[0], growth[0])],
    )


def _few(runs: int) -> int:
    return max(20, runs // _SHARE)


def _linear_picture(t: Floats, fused: Runs, side: Floats, growth: Floats) -> Picture:
    third = fused.estimate("perimeter")[0] - fused.estimate("side_a")[0] - fused.estimate("side_b")[0]
    seen = next(one for one in fused.signals[0] if one.topic == "/sensor/selection").values[:, 2]
    return Picture(
        name="Linear system",
        panels=[
            Panel(
                x="t, s",
                y="third side, m",
                lines=[
                    Line(label="truth", x=t, y=side, role="truth"),
                    Line(label="filter", x=t, y=third, role="fused"),
                ],
            ),
            Panel(
                x="t, s",
                y="growth, m/s",
                lines=[
                    Line(label="measured", x=t, y=seen, role="measured"),
                    Line(label="truth", x=t, y=growth, role="truth"),
                    Line(label="filter", x=t, y=fused.estimate("growth")[0], role="fused"),
                ],
            ),
        ],
    )


def circle_plan(circling: Circling) -> Plan:
    """The EKF of eq. 18-21: wheels drive f, range and bearing from the station are h.

    It starts at the second stamp, where the first measured step ends, and where the wheels have not lied yet.
    """
    start = np.array([circling.radius, 0.0, np.pi / 2])
    x, y, yaw = arc(start, np.array([circling.speed, circling.speed / circling.radius]), circling.dt).tolist()
    slipped = max(circling.slip * circling.dt**0.5, _EXACT)
    return plan_of(
        model={
            "name": "differential_drive",
            "process_noise": {"x": circling.slip**2, "y": circling.slip**2, "yaw": 0.0},
        },
        initial={"state": {"x": x, "y": y, "yaw": yaw}, "sd": {"x": slipped, "y": slipped, "yaw": _EXACT}},
        sensors={
            "wheels": {
                "topic": "/wheel/twist",
                "kind": "input",
                "hold": "previous",
                "noise": {"v": circling.wheel_v, "yaw_rate": circling.wheel_yaw_rate},
            },
            "station": {
                "topic": "/station/polar",
                "kind": "polar",
                "fuse": ["range", "bearing"],
                "fields": {"range": "values[0]", "bearing": "values[1]"},
                "noise": {"range": circling.range_sd, "bearing": circling.bearing_sd},
            },
        },
    )


def nonlinear_system(runs: int, circling: Circling | None = None) -> Experiment:
    """The EKF around a station, against dead reckoning and the station alone."""
    circling = circling or Circling()
    signals = simulate_runs(nonlinear_signals, circling, _CIRCLE_S, _few(runs), seed=22)
    fused = fuse_runs(circle_plan(circling), signals)
    quaternion = fused.truth(2), fused.truth(3)
    turned = fused.estimate("yaw") - 2 * np.arctan2(*quaternion)
    errors = [fused.error("x"), fused.error("y", 1), np.angle(np.exp(1j * turned))]
    polar = np.stack([_values(run, "/station/polar") for run in signals])
    station = np.stack([polar[..., 0] * np.cos(polar[..., 1]), polar[..., 0] * np.sin(polar[..., 1])], axis=-1)
    alone = np.hypot(station[..., 0] - fused.truth(0), station[..., 1] - fused.truth(1))
    wheels = np.stack([_dead_reckoning(circling, _values(run, "/wheel/twist")) for run in signals])
    lost = np.hypot(wheels[..., 0] - fused.truth(0), wheels[..., 1] - fused.truth(1))
    claimed = float(np.sqrt(np.mean(fused.variance("x") + fused.variance("y"))))
    nees = np.mean(fused.nees(("x", "y", "yaw"), errors), axis=1)
    figures = [
        rms_figure(
            "error of position, EKF",
            np.hypot(errors[0], errors[1]),
            unit="m",
            expected=claimed,
            slack=_SLACK * claimed,
            note="expected is what the filter says of itself",
        ),
        mean_figure("NEES of x, y, yaw", nees, expected=3.0, slack=_SLACK * 3),
        rms_figure("error of position, station alone", alone, unit="m", note="the article has no number"),
        rms_figure("error of position, wheels alone", lost, unit="m", note="the article has no number"),
    ]
    tracks = [
        Line(label="station", x=station[0, :, 0], y=station[0, :, 1], role="measured"),
        Line(label="wheels alone", x=wheels[0, :, 0], y=wheels[0, :, 1], role="wrong"),
        Line(label="truth", x=fused.truth(0)[0], y=fused.truth(1)[0], role="truth"),
        Line(label="EKF", x=fused.estimate("x")[0], y=fused.estimate("y")[0], role="fused"),
    ]
    t = times(len(tracks[2].x), circling.dt)
    distances = [
        Line(label="station", x=t, y=alone[0], role="measured"),
        Line(label="wheels alone", x=t, y=lost[0], role="wrong"),
        Line(label="EKF", x=t, y=np.hypot(errors[0][0], errors[1][0]), role="fused"),
    ]
    return Experiment(
        title="Nonlinear: a robot around a station that measures range and bearing (eq. 18-21)",
        text="The article has no numbers, and its Jacobians (20), (21) are lost; fuselog derives them from the model.",
        figures=figures,
        pictures=[
            Picture(
                name="EKF",
                panels=[
                    Panel(x="x, m", y="y, m", lines=tracks, plan=True),
                    Panel(x="t, s", y="distance from the truth, m", lines=distances),
                ],
            )
        ],
    )


def _values(run: list[Signal], topic: str) -> Floats:
    return next(signal for signal in run if signal.topic == topic).values


def _dead_reckoning(circling: Circling, twist: Floats) -> Floats:
    """Poses (n, 3) by the wheels (n, 2) alone."""
    pose = np.array([circling.radius, 0.0, np.pi / 2])
    poses: list[Floats] = []
    for one in twist:
        pose = arc(pose, one, circling.dt)
        poses.append(pose)
    return np.stack(poses)


def prove_update() -> Proof:
    """E3: (7) with its bracket as printed, for P = [[2, .5], [.5, 1]], H = [1, 0], R = 1."""
    P, H = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([[1.0, 0.0]])
    K = P @ H.T / (H @ P @ H.T + 1.0)
    printed, right = np.eye(2) - K @ H @ P, (np.eye(2) - K @ H) @ P
    least = (float(np.linalg.eigvalsh(one).min()) for one in (printed, right))
    numbers = dict(zip(("least eigenvalue printed", "least eigenvalue right"), least, strict=True))
    numbers |= {"variance printed": float(printed[0, 0]), "variance right": float(right[0, 0])}
    return Proof(numbers=numbers, holds=numbers["least eigenvalue printed"] < 0 < numbers["least eigenvalue right"])


def prove_noise() -> Proof:
    """E4: the variance that a second adds with density 1, by (13) and by the integral, at several rates."""
    numbers: dict[str, float] = {}
    apart = 0.0
    for dt in (1.0, 0.1, 0.01, 0.001):
        right = float(van_loan([[0.0]], np.zeros((1, 0)), [[1.0]], dt).Q[0, 0]) / dt
        numbers[f"printed at dt = {dt:g}"] = dt**2 / dt
        apart = max(apart, abs(right - 1))
    numbers["integral, at any of them"] = 1 + apart
    return Proof(numbers=numbers, holds=apart < 1e-9 and numbers["printed at dt = 0.001"] < 0.01)


def prove_transition() -> Proof:
    """E4b: how a rotation of 2 rad/s grows in a second by I + dt Fc, and by the exponential."""
    Fc = np.array([[0.0, -2.0], [2.0, 0.0]])
    numbers: dict[str, float] = {}
    for dt in (0.01, 0.1):
        n = round(1 / dt)
        exact = van_loan(Fc, np.zeros((2, 0)), np.zeros((2, 2)), dt).F
        for name, F in ((f"printed at dt = {dt:g}", np.eye(2) + dt * Fc), (f"exponential at dt = {dt:g}", exact)):
            numbers[name] = float(np.linalg.norm(np.linalg.matrix_power(F, n), 2))
    holds = numbers["printed at dt = 0.1"] > 1.2 and abs(numbers["exponential at dt = 0.1"] - 1) < 1e-9
    return Proof(numbers=numbers, holds=holds)


def prove_place() -> Proof:
    """E4c: by how much the rows of H turn between the last estimate and the prediction, on the circle."""
    circling = Circling()
    driven = circle(circling, 600, np.random.default_rng(0))
    bearing = np.arctan2(driven.pose[:, 1], driven.pose[:, 0])
    turned = float(np.sqrt(np.mean(np.angle(np.exp(1j * np.diff(bearing))) ** 2)))
    numbers = {"rows of H turn by, rad a step": turned, "sd of the bearing, rad": circling.bearing_sd}
    return Proof(numbers=numbers, holds=turned > 0.2 * circling.bearing_sd)


ERRATA = (
    Erratum(
        id="E3",
        where="eq. (7)",
        printed="P = (I − KHP⁻)",
        correct="P = (I − KH) P⁻; as printed it is no covariance.",
        prove=prove_update,
    ),
    Erratum(
        id="E4",
        where="eq. (13)",
        printed="Q = Δt² Qc",
        correct="Q = ∫ Φ Qc Φᵀ dt, about Δt Qc, where Qc is a density. As printed, what a second adds depends on the "
        "rate; it holds only for an error that is constant in a step.",
        prove=prove_noise,
    ),
    Erratum(
        id="E4b",
        where="eq. (12)",
        printed="F = I + Δt Fc",
        correct="F = exp(Δt Fc). As printed, a rotation grows.",
        prove=prove_transition,
    ),
    Erratum(
        id="E4c",
        where="EKF",
        printed="H at the previous state; x̂ = F x̂(k|k−1) + G y",
        correct="H at the prediction x̂(k|k−1); x̂ = F x̂(k−1) + G u. Also ẋ and indices in (9)-(12), y for z in (6).",
        prove=prove_place,
    ),
)
