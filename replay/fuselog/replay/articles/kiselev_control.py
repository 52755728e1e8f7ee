"""Kiselev 2020, 3.4: the robot that is held to the wall, with wheels that saturate."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Filter
from fuselog.replay.articles.kiselev_wall import errors_of, fuse_drives, optimum, vector_theory, wall_plan
from fuselog.replay.articles.result import Experiment, Figure, Line, Panel, Picture, rms_figure
from fuselog.replay.articles.runs import connect, times
from fuselog.replay.articles.theory import rms
from fuselog.replay.scenarios.kiselev_wall import (
    Drive,
    Robot,
    constant_wheels,
    deadbeat,
    drive,
    drive_signals,
    twist_from_wheels,
)
from fuselog.replay.scenarios.planar import arc
from fuselog.replay.signals import Signal, encode

Floats = NDArray[np.float64]

FIGURE_10 = Robot(sigma_xi=0.01, sigma_eta=0.02, sigma_theta=0.02, omega_right=1.001)
STEPS = 500
_WATCHED = 100  # steps of the runs that fuselog's filter watches
_FREE = 1e9  # rad/s, a limit that is none
_SLACK = 0.01  # of an error, for the linearisation about a robot that stands still


def figure_10(runs: int, robot: Robot = FIGURE_10) -> Experiment:
    """The closed loop: what it does, what it would do without saturation, and how well the filter knows."""
    driven = drive(robot, STEPS, np.random.default_rng(10), deadbeat, (runs,))
    informed = hold(robot, STEPS, np.random.default_rng(11), runs)
    free = hold(replace(robot, limit=_FREE), STEPS, np.random.default_rng(12), runs)
    watched = _start_of(driven, _WATCHED)
    fused = errors_of(fuse_drives(robot, watched, wall_plan(robot)), watched)
    vector = (watched.estimate - watched.pose)[1:]
    standing = replace(robot, omega_left=0.0, omega_right=0.0)
    best, decoupled = optimum(standing, _WATCHED), vector_theory(standing, _WATCHED)
    knowing = rms_figure("Fig. 10, distance to the wall with the state known", informed[1:, :, 1].T, unit="m")
    largest: Floats = np.max(np.abs(driven.wheels[1:]), axis=-1)
    figures = [
        rms_figure(
            "Fig. 10, y without saturation",
            free[2:, :, 1].T,
            unit="m",
            printed="0.01",
            expected=robot.sigma_xi,
            note="the article's claim y = ξ, with the state known",
        ),
        rms_figure(
            "Fig. 10, α without saturation",
            free[2:, :, 2].T,
            unit="rad",
            printed="0.01",
            expected=robot.sigma_zeta,
            note="the claim α = ζ",
        ),
        rms_figure(
            "Fig. 10, distance to the wall",
            driven.pose[1:, :, 1].T,
            unit="m",
            expected=knowing.ours,
            slack=3 * knowing.sigma,
            note=f"within ±{robot.limit:g} rad/s, as printed; it is not ξ. In place of theory: a loop that knows "
            "its state, which saturation keeps from being better",
        ),
        Figure(
            name="Fig. 10, steps on which neither wheel saturates",
            ours=100 * float(np.mean(largest < robot.limit)),
            unit="%",
            runs=runs,
            note="the article has no number",
        ),
    ]
    for i, (name, unit) in enumerate((("y", "m"), ("α", "rad"))):
        for method, errors, theory in (
            ("filter", fused[i], rms(best[:, i])),
            ("vector of 3.3", vector[..., i + 1].T, rms(decoupled[:, i])),
        ):
            figures.append(
                rms_figure(f"Fig. 10, {method}, {name}", errors, unit=unit, expected=theory, slack=_SLACK * theory)
            )
    return Experiment(
        title="Fig. 10: robot held to the wall by deadbeat control",
        text="The picture is one run with fuselog's filter in the loop, sample by sample. Means over many runs are of "
        "the loop with the article's own filter, the vector of 3.3; fuselog's filter watches their first 100 steps.",
        figures=figures,
        pictures=[_picture(robot)],
    )


def _start_of(driven: Drive, n: int) -> Drive:
    """The first n steps."""
    return Drive(
        pose=driven.pose[: n + 1],
        wheels=driven.wheels[:n],
        xi=driven.xi[:n],
        zeta=driven.zeta[:n],
        u=driven.u[:n],
        beta=driven.beta[:n],
        estimate=driven.estimate[: n + 1],
    )


def hold(robot: Robot, n: int, noise: np.random.Generator, runs: int) -> Floats:
    """Poses (n + 1, runs, 3) of a loop that knows its state."""
    pose = np.zeros((n + 1, runs, 3))
    pose[0] = 0.0, robot.y0, robot.alpha0
    for i in range(n):
        pose[i + 1] = arc(pose[i], twist_from_wheels(robot, deadbeat(robot, pose[i])), robot.dt)
        pose[i + 1, :, 1] += robot.sigma_xi * noise.standard_normal(runs)
        pose[i + 1, :, 2] += robot.sigma_zeta * noise.standard_normal(runs)
    return pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """One run with fuselog's filter in the loop."""

    pose: Floats  # (n + 1, 3)
    estimate: Floats  # (n + 1, 2) y (m), alpha (rad)
    wheels: Floats  # (n, 2) rad/s


def hold_by_filter(robot: Robot, n: int, noise: np.random.Generator) -> Held:
    """The loop of ``drive`` with fuselog's filter on board: messages go in as they come about, step by step."""
    filter = Filter(wall_plan(robot), order="as_received")
    pose, estimate = np.zeros((n + 1, 3)), np.zeros((n + 1, 2))
    pose[0] = 0.0, robot.y0, robot.alpha0
    estimate[0] = pose[0, 1:]
    wheels = np.zeros((n, 2))
    for i in range(n):
        command = deadbeat if i else constant_wheels
        wheels[i] = command(robot, np.array([0.0, *estimate[i]]))
        pose[i + 1] = arc(pose[i], twist_from_wheels(robot, wheels[i]), robot.dt)
        pose[i + 1, 1:] += noise.standard_normal(2) * (robot.sigma_xi, robot.sigma_zeta)
        signals = _step_signals(robot, pose[i : i + 2], wheels[i : i + 1], noise)
        if i == 0:
            connect(filter.intake, signals)
        late = round(i * robot.dt * 1e9)
        signals = [replace(signal, t_ns=signal.t_ns + late) for signal in signals]
        filter.feed(encode(signals, range(len(signals))))
        estimate[i + 1] = filter.estimate.x
    return Held(pose=pose, estimate=estimate, wheels=wheels)


def _step_signals(robot: Robot, pose: Floats, wheels: Floats, noise: np.random.Generator) -> list[Signal]:
    """What wheels and sensors say of one step."""
    eta, theta = noise.standard_normal(2) * (robot.sigma_eta, robot.sigma_theta)
    u = pose[1:, 1] + robot.a * np.sin(pose[1:, 2]) + eta
    nothing = np.zeros(1)
    driven = Drive(
        pose=pose, wheels=wheels, xi=nothing, zeta=nothing, u=u, beta=pose[1:, 2] + theta, estimate=np.zeros((2, 3))
    )
    return [
        one for one in drive_signals(robot, driven) if one.topic in ("/wheel/twist", "/wall/distance", "/gyro/attitude")
    ]


def _picture(robot: Robot) -> Picture:
    held = hold_by_filter(robot, STEPS, np.random.default_rng(13))
    t = np.concatenate([[0.0], times(STEPS, robot.dt)])

    def panel(label: str, true: Floats, found: Floats) -> Panel:
        return Panel(
            x="t, s",
            y=label,
            lines=[
                Line(label="truth", x=t, y=true, role="truth"),
                Line(label="filter in the loop", x=t, y=found, role="fused"),
            ],
        )

    left, right = held.wheels.T
    wheels = Panel(
        x="t, s",
        y="ω, rad/s (first 5 s)",
        lines=[
            Line(label="left", x=t[:50], y=left[:50], role="other"),
            Line(label="right", x=t[:50], y=right[:50], role="measured"),
        ],
    )
    return Picture(
        name="Fig. 10",
        panels=[
            panel("y, m", held.pose[:, 1], held.estimate[:, 0]),
            panel("α, rad", held.pose[:, 2], held.estimate[:, 1]),
            wheels,
        ],
    )
