"""Where the generated model goes: ``step`` is compiled with these names replaced by those of a real model.

The values here are those of the smallest model there is, one number that stays as it is, so that ``step`` can be
read, checked and imported by itself.
"""

import numpy as np
from numpy.typing import NDArray

N = 1  # states
LD = 4  # numbers from one row of P to the next
U = 0  # inputs
WIDTH = 1  # most states that one measured number depends on
ANGLES = np.array([0], np.uint8)  # which states are angles

Flat = NDArray[np.float64]


def predict(s: Flat, a: int, b: int, dt: float, q: Flat, w: Flat) -> None:
    """State row b from row a after dt: x = f(x, u, dt), P = F P F' + Q. w is scratch of 2 N LD numbers."""


def observe(
    row: int, s: Flat, a: int, par: Flat, p: int, z: Flat, za: int, hv: Flat, hi: NDArray[np.int64], k: int
) -> tuple[float, int]:
    """Quantity number ``row`` at the state s[a:]: returns h and how many derivatives it left in hv, hi."""
    return 0.0, 0


__all__ = ["ANGLES", "LD", "N", "U", "WIDTH", "observe", "predict"]
