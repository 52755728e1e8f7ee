"""The slips of Kiselev 2020, chapters 2 and 3, each with its numbers."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.design import Corrected, dare, kappa_gain
from fuselog.replay.articles.kiselev_control import FIGURE_10
from fuselog.replay.articles.kiselev_wall import FIGURE_8, FIGURE_9, linear, vector_theory
from fuselog.replay.articles.result import Erratum, Proof
from fuselog.replay.scenarios.kiselev_wall import Robot, deadbeat, gains, twist_from_wheels
from fuselog.replay.scenarios.planar import arc

Floats = NDArray[np.float64]

# 1.25 m/s and a boom of half a metre: what couples y and alpha.
FAST = Robot(sigma_xi=0.01, sigma_eta=0.02, sigma_theta=0.3, a=0.5, omega_left=50.0, omega_right=50.0)
LONG_BOOM = Robot(sigma_xi=0.02, sigma_zeta=0.02, sigma_eta=0.02, sigma_theta=0.1, a=1.5)


def _wheels(robot: Robot) -> Floats:
    return np.array([robot.omega_left, robot.omega_right])


def printed_arc(robot: Robot, y: float, alpha: float, wheels: Floats) -> float:
    """y' by equation (4) as printed, which divides by the difference of the wheels."""
    left, right = wheels
    turned = alpha + robot.D / (2 * robot.K) * (right - left) / 2 * robot.dt
    return float(y - (right + left) / (right - left) * robot.K * (np.cos(turned) - np.cos(alpha)))


def prove_sign() -> Proof:
    """E7: the change of y in one step, exact and as linearised in (7), (8), (10), (17)."""
    robot = FIGURE_8
    pose = np.array([0.0, 0.0, robot.alpha0])
    exact = float(arc(pose, twist_from_wheels(robot, _wheels(robot)), robot.dt)[1])
    half = robot.D / 4 * (robot.omega_right + robot.omega_left) * robot.alpha0 * robot.dt
    numbers = {"exact arc, m": exact, "as printed, m": -half, "right sign, m": half}
    return Proof(numbers=numbers, holds=abs(exact - half) < 0.01 * half)


def prove_noise_in_arc() -> Proof:
    """E7b: the noise of y where zeta stands inside cos(alpha'), by the wheels' difference."""
    zeta = FIGURE_9.sigma_zeta * np.random.default_rng(71).standard_normal(100_000)
    numbers: dict[str, float] = {}
    for right in (1.01, 1.001, 1.0001):
        radius = FIGURE_8.K * (right + 1) / (right - 1)
        numbers[f"sd of y at ωR = {right:g}, m"] = float(np.std(radius * np.cos(0.1 + zeta)))
    speed = float(twist_from_wheels(FIGURE_8, np.array([1.0, 1.0]))[0])
    numbers["way in the step, m"] = speed * FIGURE_8.dt
    return Proof(numbers=numbers, holds=numbers["sd of y at ωR = 1.0001, m"] > 100 * speed * FIGURE_8.dt)


def prove_decoupled() -> Proof:
    """E7c: what the vector of 3.3 claims of its errors, and what they are, where y and alpha are coupled."""
    n = 400
    k = gains(LONG_BOOM, n)[-1]
    measured = LONG_BOOM.sigma_eta**2 + (LONG_BOOM.a * LONG_BOOM.sigma_zeta) ** 2
    claimed = float(np.sqrt(k[0] * measured))  # of a settled scalar filter
    actual = float(np.sqrt(vector_theory(LONG_BOOM, n)[-1, 0]))
    best = _optimal(LONG_BOOM)
    numbers = {
        "claimed sd of y, m": claimed,
        "actual sd of y, m": actual,
        "coupled filter, m": float(np.sqrt(best.posterior[0, 0])),
    }
    return Proof(numbers=numbers, holds=actual > 1.5 * claimed)


def _optimal(robot: Robot) -> Corrected:
    step = linear(robot)
    return dare(step.F, step.H, step.Q, step.R)


def prove_fraction() -> Proof:
    """E10: the y that is left after the step of 3.4, with the fraction as printed in the system and upside down."""
    robot = replace(FIGURE_10, limit=1e9)
    y, alpha = 0.1, 0.2
    left, right = deadbeat(robot, np.array([0.0, y, alpha]))
    lost = robot.K * (1 - np.cos(alpha))
    numbers = {
        "left with (ωR + ωL)/(ωR − ωL), m": float(y - (right + left) / (right - left) * lost),
        "left with (ωR − ωL)/(ωR + ωL), m": float(y - (right - left) / (right + left) * lost),
    }
    near, far = (abs(number) for number in numbers.values())
    return Proof(numbers=numbers, holds=near < 1e-12 < far)


def prove_boom() -> Proof:
    """E11: z = y - a alpha + eta against what the sensor says, u = y + a sin(alpha) (6), at alpha = 0.1."""
    y, alpha = 0.5, 0.1
    u = float(y + FIGURE_10.a * np.sin(alpha))
    numbers = {
        "bias of y − aα, m": float(y - FIGURE_10.a * alpha - y),
        "bias of u − a sin α, m": float(u - FIGURE_10.a * np.sin(alpha) - y),
    }
    printed, right = numbers.values()
    return Proof(numbers=numbers, holds=printed < -0.01 and abs(right) < 1e-12)


def prove_straight() -> Proof:
    """E14: equation (4) near equal wheels, where both arcs should agree, and the arc of fuselog at equal ones."""
    robot, alpha = FIGURE_8, 0.1
    pose = np.array([0.0, 0.0, alpha])

    def exact(right: float) -> float:
        return float(arc(pose, twist_from_wheels(robot, np.array([1.0, right])), robot.dt)[1])

    numbers = {
        "difference at ωR = 1.01, m": printed_arc(robot, 0.0, alpha, np.array([1.0, 1.01])) - exact(1.01),
        "difference at ωR = 1 + 1e-14, m": printed_arc(robot, 0.0, alpha, np.array([1.0, 1 + 1e-14]))
        - exact(1 + 1e-14),
        "ours at ωR = ωL, m": exact(1.0),
    }
    near, far, straight = numbers.values()
    way = float(twist_from_wheels(robot, np.array([1.0, 1.0]))[0]) * robot.dt
    holds = abs(near) < 1e-12 and abs(far) > 1e-5 and abs(straight - way * np.sin(alpha)) < 1e-15
    return Proof(numbers=numbers, holds=bool(holds))


def prove_kappa() -> Proof:
    """E15: kappa of (16) on the fast robot: with every element of the gain free, and with a diagonal one.

    The measurements are z = u - a beta and beta, so that a diagonal gain is one that fuses each on its own.
    """
    step = linear(FAST)
    apart = np.array([[1.0, -FAST.a], [0.0, 1.0]])
    H, R = apart @ step.H, apart @ step.R @ apart.T
    best = dare(step.F, H, step.Q, R)
    start = np.diag([best.G[0, 0] / 2, best.G[1, 1] / 4])
    changed = 0.0
    diagonal: dict[float, Corrected] = {}
    for kappa in (0.01, 0.5, 0.99):
        weights = [kappa, 1 - kappa]
        free = kappa_gain(step.F, H, step.Q, R, weights, free=np.ones((2, 2)), start=best.G * 0.9)
        changed = max(changed, float(np.abs(free.G - best.G).max()))
        diagonal[kappa] = kappa_gain(step.F, H, step.Q, R, weights, free=np.eye(2), start=start)
    numbers = {"most that κ changes of the full gain": changed}
    for kappa in (0.01, 0.99):
        found = diagonal[kappa]
        sd_y, sd_alpha = np.sqrt(np.diag(found.posterior)).tolist()
        numbers |= {
            f"k_y, diagonal, κ = {kappa:g}": float(found.G[0, 0]),
            f"k_α, diagonal, κ = {kappa:g}": float(found.G[1, 1]),
            f"sd of y, diagonal, κ = {kappa:g}, m": sd_y,
            f"sd of α, diagonal, κ = {kappa:g}, rad": sd_alpha,
        }
    moved = numbers["k_α, diagonal, κ = 0.99"] > 5 * numbers["k_α, diagonal, κ = 0.01"]
    return Proof(numbers=numbers, holds=changed < 1e-4 and moved)


ERRATA = (
    Erratum(
        id="E7",
        where="eq. (7), (8), (10), (17)",
        printed="cos α' − cos α ≈ +½(α'² − α²), so that y' = y − (D/4)(ωR + ωL) α dt",
        correct="cos α' − cos α ≈ −½(α'² − α²): y grows with α, y' = y + (D/4)(ωR + ωL) α dt.",
        prove=prove_sign,
    ),
    Erratum(
        id="E7b",
        where="eq. (13)",
        printed="ζ inside cos α'",
        correct="The prediction of α in the arc, and ζ added after it: inside, it is multiplied by the radius of the "
        "turn, which has no limit, and not by the way.",
        prove=prove_noise_in_arc,
    ),
    Erratum(
        id="E7c",
        where="3.3, k_y and σ_y²",
        printed="no a²σ_α² in the denominator, no covariance between y and α",
        correct="The coupled filter. Invisible with the numbers of Fig. 9; with a boom of 1.5 m the vector believes "
        "itself more than twice as good as it is.",
        prove=prove_decoupled,
    ),
    Erratum(
        id="E10",
        where="3.4, the system for the wheels",
        printed="(ωR − ωL)/(ωR + ωL)·K",
        correct="(ωR + ωL)/(ωR − ωL)·K; the printed solution is that of the right system.",
        prove=prove_fraction,
    ),
    Erratum(
        id="E11",
        where="3.4",
        printed="z = y − aα + η",
        correct="u = y + a sin α + η by (6), so that y is u − a sin α.",
        prove=prove_boom,
    ),
    Erratum(
        id="E14",
        where="eq. (4)",
        printed="(ωR + ωL)/(ωR − ωL)",
        correct="0/0 for equal wheels, which saturation brings about, and loss of digits near them. The same arc "
        "without a division: y' = y + v dt sinc(h) sin(α + h), h half the turn.",
        prove=prove_straight,
    ),
    Erratum(
        id="E15",
        where="eq. (16)",
        printed="κ chooses between y and α",
        correct="The optimal gain is best for every κ at once; κ matters only where elements of the gain are held "
        "at 0.",
        prove=prove_kappa,
    ),
)
