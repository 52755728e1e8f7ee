"""Kiselev 2020, chapters 2 and 3: the robot along a wall, with one sensor, with two, and held to it."""

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.fusion.design import Step, make_step, steady_scalar_gain
from fuselog.replay.articles.result import Experiment, Figure, Line, Panel, Picture, rms_figure
from fuselog.replay.articles.runs import Runs, fuse_runs, plan_of, times
from fuselog.replay.articles.theory import moments, riccati, rms
from fuselog.replay.scenarios.kiselev_wall import (
    Drive,
    Robot,
    constant_wheels,
    drive,
    drive_signals,
    gains,
    twist_from_wheels,
)
from fuselog.replay.signals import Signal

Floats = NDArray[np.float64]

STEPS = 100
FIGURE_8, FIGURE_9 = Robot(sigma_zeta=0.0), Robot()
_SLACK = 0.005  # of an error, that linearisation may cost or gain
_EXACT = 1e-9  # sd of what is known


def wall_plan(robot: Robot, *, gyro: bool = True, **rest: Any) -> Plan:
    """The configuration of the article's robot; ``rest`` are further parts, such as the gain."""
    distance = {"topic": "/wall/distance", "fuse": ["y"], "fields": {"y": "values[0]"}, "noise": {"y": robot.sigma_eta}}
    sensors = {
        "wheels": {"topic": "/wheel/twist", "kind": "input", "noise": {"v": _EXACT, "yaw_rate": _EXACT}},
        "distance": {**distance, "mount": {"xyz": [robot.a, 0, 0]}},
        "gyro": {"topic": "/gyro/attitude", "fuse": ["yaw"], "noise": {"yaw": robot.sigma_theta}},
    }
    noise = {"y": robot.sigma_xi**2 / robot.dt, "yaw": robot.sigma_zeta**2 / robot.dt}
    return plan_of(
        model={"name": "wall_follower", "process_noise": noise},
        initial={"state": {"y": robot.y0, "yaw": robot.alpha0}, "sd": {"y": _EXACT, "yaw": _EXACT}},
        sensors=sensors if gyro else {name: one for name, one in sensors.items() if name != "gyro"},
        **rest,
    )


def run_of(driven: Drive, run: int) -> Drive:
    """One of the runs that were driven together."""
    arrays = {field.name: getattr(driven, field.name) for field in fields(Drive)}
    return Drive(**{name: array[:, run] for name, array in arrays.items()})


def fuse_drives(robot: Robot, driven: Drive, plan: Plan) -> Runs:
    """Every run through the filter."""
    runs: list[list[Signal]] = [drive_signals(robot, run_of(driven, run)) for run in range(driven.u.shape[1])]
    return fuse_runs(plan, runs)


def linear(robot: Robot) -> Step:
    """The robot along alpha = 0: y' = y + v dt alpha + xi; u = y + a alpha + eta, beta = alpha + theta."""
    speed = float(twist_from_wheels(robot, constant_wheels(robot, np.zeros(3)))[0])
    return make_step(
        [[1.0, speed * robot.dt], [0.0, 1.0]],
        np.diag([robot.sigma_xi**2, robot.sigma_zeta**2]),
        [[1.0, robot.a], [0.0, 1.0]],
        np.diag([robot.sigma_eta**2, robot.sigma_theta**2]),
    )


def vector_theory(robot: Robot, n: int) -> Floats:
    """The variances (n, 2) of y and alpha that Kiselev's vector has, with the covariance that it does not know."""
    return _variances(moments(linear(robot), [np.diag(k) for k in gains(robot, n)], np.zeros((2, 2))))


def _variances(P: Floats) -> Floats:
    return np.diagonal(P, axis1=1, axis2=2)


def optimum(robot: Robot, n: int) -> Floats:
    """The variances (n, 2) of the coupled filter."""
    return _variances(np.stack([one.posterior for one in riccati(linear(robot), n, np.zeros((2, 2)))]))


def errors_of(fused: Runs, driven: Drive) -> tuple[Floats, Floats]:
    """Estimate less truth of y (m) and alpha (rad), each (runs, n)."""
    turned = fused.estimate("yaw") - driven.pose[1:, :, 2].T
    return fused.estimate("y") - driven.pose[1:, :, 1].T, np.angle(np.exp(1j * turned))


def figure_8(runs: int, robot: Robot = FIGURE_8) -> Experiment:
    """Distance only, heading by dead reckoning."""
    driven = drive(robot, STEPS, np.random.default_rng(8), constant_wheels, (runs,))
    fused = fuse_drives(robot, driven, wall_plan(robot, gyro=False))
    raw = (driven.u - robot.a * np.sin(driven.estimate[1:, :, 2]) - driven.pose[1:, :, 1]).T
    step = make_step([[1.0]], [[robot.sigma_xi**2]], [[1.0]], [[robot.sigma_eta**2]])
    theory = rms(np.array([one.posterior[0, 0] for one in riccati(step, STEPS, [[0.0]])]))
    k = steady_scalar_gain(robot.sigma_xi**2, robot.sigma_eta**2)
    figures = [
        Figure(name="Fig. 8, gain it settles at", ours=float(fused.absorbed("distance")[-1]), expected=k, slack=1e-6),
        rms_figure("Fig. 8, filter, y", errors_of(fused, driven)[0], unit="m", expected=theory, slack=_SLACK * theory),
        rms_figure("Fig. 8, sensor alone, y", raw, unit="m", expected=robot.sigma_eta),
    ]
    return Experiment(
        title="Fig. 8: robot along a wall, ultrasonic sensor",
        text="The article shows the picture and no number; theory is the scalar recursion of 1.4.",
        figures=figures,
        pictures=[Picture(name="Fig. 8", panels=[distance_panel(robot, driven, fused)])],
    )


def figure_9(runs: int, robot: Robot = FIGURE_9) -> Experiment:
    """Distance and gyro: the coupled filter, its steady gain, and the article's vector."""
    driven = drive(robot, STEPS, np.random.default_rng(9), constant_wheels, (runs,))
    fused = fuse_drives(robot, driven, wall_plan(robot))
    constant = fuse_drives(robot, driven, wall_plan(robot, gain=_steady(robot)))
    vector = np.moveaxis((driven.estimate - driven.pose)[1:, :, 1:], -1, 0).swapaxes(1, 2)
    raw = (driven.u - robot.a * np.sin(driven.beta) - driven.pose[1:, :, 1]).T, (driven.beta - driven.pose[1:, :, 2]).T
    best, decoupled = optimum(robot, STEPS), vector_theory(robot, STEPS)
    alone = float(np.hypot(robot.sigma_eta, robot.a * robot.sigma_theta)), robot.sigma_theta
    figures: list[Figure] = []
    for i, (name, unit) in enumerate((("y", "m"), ("α", "rad"))):
        for method, errors, theory in (
            ("filter", errors_of(fused, driven)[i], rms(best[:, i])),
            ("filter with its steady gain", errors_of(constant, driven)[i], rms(best[:, i])),
            ("vector of 3.3", vector[i], rms(decoupled[:, i])),
            ("sensor alone", raw[i], alone[i]),
        ):
            figures.append(
                rms_figure(f"Fig. 9, {method}, {name}", errors, unit=unit, expected=theory, slack=_SLACK * theory)
            )
    return Experiment(
        title="Fig. 9: robot along a wall, ultrasonic sensor and gyro",
        text="The article shows the picture and no number; theory is the covariance of the linear filter. The "
        "article's vector (3.3) keeps no covariance between y and α, which costs nothing with these numbers.",
        figures=figures,
        pictures=[
            Picture(name="Fig. 9", panels=[distance_panel(robot, driven, fused), angle_panel(robot, driven, fused)])
        ],
    )


def _steady(robot: Robot) -> dict[str, Any]:
    """The gain of the Riccati equation, of the robot that rolls along the wall."""
    speed = float(twist_from_wheels(robot, constant_wheels(robot, np.zeros(3)))[0])
    rate = 1 / robot.dt
    return {"mode": "steady_state", "rates": {"distance": rate, "gyro": rate}, "nominal": {"v": speed}}


def distance_panel(robot: Robot, driven: Drive, fused: Runs) -> Panel:
    """y of the first run: what the sensor says with the estimated heading, truth and filter."""
    t = times(len(driven.u), robot.dt)
    yaw = fused.estimate("yaw")[0]
    return Panel(
        x="t, s",
        y="y, m",
        lines=[
            Line(label="measured", x=t, y=driven.u[:, 0] - robot.a * np.sin(yaw), role="measured"),
            Line(label="truth", x=t, y=driven.pose[1:, 0, 1], role="truth"),
            Line(label="filter", x=t, y=fused.estimate("y")[0], role="fused"),
        ],
    )


def angle_panel(robot: Robot, driven: Drive, fused: Runs) -> Panel:
    """alpha of the first run."""
    t = times(len(driven.u), robot.dt)
    return Panel(
        x="t, s",
        y="α, rad",
        lines=[
            Line(label="measured", x=t, y=driven.beta[:, 0], role="measured"),
            Line(label="truth", x=t, y=driven.pose[1:, 0, 2], role="truth"),
            Line(label="filter", x=t, y=fused.estimate("yaw")[0], role="fused"),
        ],
    )
