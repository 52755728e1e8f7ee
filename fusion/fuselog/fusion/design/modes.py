"""What a filter cannot estimate: modes that no sensor sees, that no noise drives, or that a gain lets grow."""
# A matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportConstantRedefinition=false

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuselog.fusion.design.matrices import DesignError, Floats, as_covariance, as_matrix, as_square

_RANK = 1e-10  # singular values below this share of the largest possible are 0
_DECAY = 1e-10  # a mode with |eigenvalue| above 1 - this does not decay
_CIRCLE = 1e-7  # |eigenvalue| is 1 within this: what rounding does to a double eigenvalue


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """An eigenvector (n,) and its eigenvalue; of a complex pair the one above the real axis."""

    eigenvalue: complex
    vector: NDArray[np.complex128]

    def describe(self, states: Sequence[str] = ()) -> str:
        """Such as ``x - 0.5 y (eigenvalue 1)``; without names, states are x0, x1, ..."""
        names = states or [f"x{i}" for i in range(len(self.vector))]
        shares = self.vector / self.vector[np.argmax(np.abs(self.vector))]
        text = " + ".join(
            _times(complex(share), name) for share, name in zip(shares, names, strict=True) if abs(share) > 1e-6
        )
        return f"{text.replace('+ -', '- ')} (eigenvalue {_number(self.eigenvalue)})"


class UndetectableError(DesignError):
    """Modes that no sensor sees and that do not decay: their covariance has no steady value."""

    def __init__(self, modes: Sequence[Mode], states: Sequence[str] = ()) -> None:
        super().__init__("no sensor sees " + ", ".join(mode.describe(states) for mode in modes))
        self.modes = tuple(modes)


class NoiselessError(DesignError):
    """Modes that neither decay nor have process noise: the optimal gain for them goes to 0."""

    def __init__(self, modes: Sequence[Mode], states: Sequence[str] = ()) -> None:
        super().__init__("no process noise, so no steady gain, in " + ", ".join(m.describe(states) for m in modes))
        self.modes = tuple(modes)


class UnstableError(DesignError):
    """A gain with which errors do not decay: the spectral radius of the period map is not below 1."""

    def __init__(self, mode: Mode, states: Sequence[str] = ()) -> None:
        super().__init__(
            f"the error does not decay in {mode.describe(states)}: spectral radius {abs(mode.eigenvalue):.6g}"
        )
        self.mode = mode


def undetectable_modes(F: ArrayLike, H: ArrayLike) -> tuple[Mode, ...]:
    """The modes F v = lambda v with H v = 0 and |lambda| >= 1, largest first; F (n, n), H (m, n).

    This is the test of Popov, Belevitch and Hautus (Hautus 1969), done inside the unobservable space, where a multiple
    eigenvalue does not blur it. Raises ``DesignError`` for wrong shapes.
    """
    F = as_square("F", F)
    H = as_matrix("H", H, None, len(F))
    return tuple(mode for mode in _modes(F, _unseen_space(F, H)) if abs(mode.eigenvalue) >= 1 - _DECAY)


def check_detectable(F: ArrayLike, H: ArrayLike, *, states: Sequence[str] = ()) -> None:
    """Raise ``UndetectableError``, naming the modes by ``states``, if (F, H) has ``undetectable_modes``."""
    modes = undetectable_modes(F, H)
    if modes:
        raise UndetectableError(modes, states)


def check_noisy(F: Floats, Q: Floats, *, states: Sequence[str] = ()) -> None:
    """Raise ``NoiselessError`` if Q does not reach a mode on the unit circle (Anderson and Moore 1979, section 4.4).

    The modes are left eigenvectors: combinations of states that evolve on their own.
    """
    modes = tuple(m for m in _modes(F.T, _unseen_space(F.T, Q)) if abs(abs(m.eigenvalue) - 1) < _CIRCLE)
    if modes:
        raise NoiselessError(modes, states)


def check_stable(error_map: Floats, *, states: Sequence[str] = ()) -> None:
    """Raise ``UnstableError`` with the largest mode if the spectral radius of ``error_map`` (n, n) is not below 1."""
    largest = _modes(error_map, np.eye(len(error_map)))[0]
    if abs(largest.eigenvalue) >= 1 - _DECAY:
        raise UnstableError(largest, states)


def frozen_states(F: ArrayLike, Q: ArrayLike, P0: ArrayLike) -> tuple[int, ...]:
    """The states whose variance is 0 for ever, so that no optimal gain corrects them.

    That is P0 = 0 where Q is singular, and no other state brings its uncertainty through F. F, Q and P0 are (n, n).
    """
    F = as_square("F", F)
    Q, P0 = as_covariance("Q", Q, len(F)), as_covariance("P0", P0, len(F))
    certain = _unseen_space(F.T, np.vstack([Q, P0]))
    uncertain = 1 - np.sum(certain * certain, axis=1)
    return tuple(int(i) for i in np.flatnonzero(uncertain < _RANK))


def _unseen_space(F: Floats, H: Floats) -> Floats:
    """An orthonormal basis (n, k) of the largest F-invariant space on which H is 0."""
    norms = np.linalg.norm(H, axis=1, keepdims=True)
    space = np.eye(len(F)) @ _null_space(H / np.where(norms > 0, norms, 1.0), 1.0)
    while True:
        image = F @ space
        kept = _null_space(image - space @ (space.T @ image), float(np.linalg.norm(F)))
        if kept.shape[1] == space.shape[1]:
            return space
        space = space @ kept


def _null_space(A: Floats, scale: float) -> Floats:
    if not A.size:
        return np.eye(A.shape[1])
    _, values, vectors = np.linalg.svd(A)
    return vectors[np.count_nonzero(values > _RANK * scale) :].T


def _modes(F: Floats, space: Floats) -> list[Mode]:
    """The modes of F inside an invariant space (n, k), largest first."""
    values, vectors = np.linalg.eig(space.T @ F @ space)
    modes = [
        Mode(eigenvalue=complex(value), vector=(space @ vector).astype(np.complex128))
        for value, vector in zip(values, vectors.T, strict=True)
        if value.imag >= 0
    ]
    return sorted(modes, key=lambda mode: -abs(mode.eigenvalue))


def _times(share: complex, name: str) -> str:
    if abs(share - 1) < 1e-6:
        return name
    if abs(share + 1) < 1e-6:
        return f"-{name}"
    return f"{_number(share)} {name}"


def _number(value: complex) -> str:
    if abs(value.imag) < 1e-6 * abs(value):
        return f"{value.real:.6g}"
    return f"({value.real:.6g}{value.imag:+.6g}j)"
