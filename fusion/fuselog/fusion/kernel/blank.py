"""Where the generated model goes: ``step`` is compiled with these names replaced by those of a real model.

The values here are those of the smallest model there is, one number that stays as it is, so that ``step`` can be read,
checked and imported by itself.
"""

# ruff: noqa: ARG001  what a real model uses

import numpy as np

from fuselog.fusion.kernel.tables import Floats, Ints

N = 1  # states
LD = 4  # numbers from one row of P to the next
X = 4  # numbers of x as it is kept: the states, and behind them the quaternion of a rotation
U = 0  # inputs
M = 1  # numbers that one sample measures at most
SENSORS = 1
ALIKE = True  # whether each sample measures as many
DENSITIES = 1  # of the process noise, the first numbers of q
WIDTH = 1  # most states that one measured number depends on
ANGLES = np.array([0], np.uint8)  # which states are angles
LIMITED = False  # whether a state has a limit
LIMITS = np.array([np.inf])  # from which absolute value of a state on there is no estimate
ROTATION = -1  # where roll, pitch, yaw stand when they are kept as a quaternion


def predict(s: Floats, a: int, b: int, dt: float, q: Floats, w: Floats) -> None:
    """State row b from row a after dt: x = f(x, u, dt), P = F P F' + Q. w is scratch of 2 LD LD numbers.

    P is symmetric but for rounding.
    """


def move(s: Floats, a: int, b: int, dt: float, q: Floats) -> None:
    """The x of state row b from row a after dt, as ``predict``."""


def disturb(s: Floats, a: int, b: int, dt: float, q: Floats) -> None:
    """Add the Q of ``predict`` to P of state row b, on and above the diagonal; x of row a and the input of row b."""


def linearise(s: Floats, a: int, b: int, dt: float, q: Floats, F: Floats, Q: Floats) -> None:
    """F (I before) and Q (0 before), rows of N numbers, of ``predict`` from row a, input in row b."""


def adjoin(s: Floats, a: int, b: int, dt: float, q: Floats, A: Floats, w: Floats) -> None:
    """F' A F in place of A and F' l of the row l behind it, by F of ``predict``. w is scratch of 3 LD LD numbers."""


def inject(s: Floats, a: int, w: Floats, d: int) -> None:
    """Correct the x of state row a by the N numbers w[d:]."""


def observe(
    row: int, s: Floats, a: int, par: Floats, p: int, z: Floats, za: int, q: Floats, hv: Floats, hi: Ints, k: int
) -> tuple[float, int]:
    """Quantity number ``row`` at the state s[a:]: returns h and how many derivatives it left in hv, hi."""
    return 0.0, 0
