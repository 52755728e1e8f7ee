"""What a motion model is: states with units, a transition, its noise, and where the body is, all symbolic."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false
# pyright: reportReturnType=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import sympy as sp

from fuselog.schemas.errors import FuselogError

Expr = sp.Expr
DT = sp.Symbol("dt", positive=True)  # s, time since the state was last known


class sinc(sp.Function):  # noqa: N801  a mathematical function keeps its name
    """sin(x)/x, finite at 0; its derivative stays accurate there too."""

    def fdiff(self, argindex: int = 1) -> Expr:  # noqa: ARG002  SymPy's protocol
        return dsinc(self.args[0])


class dsinc(sp.Function):  # noqa: N801  a mathematical function keeps its name
    """d/dx sin(x)/x."""


class root_cos(sp.Function):  # noqa: N801  a mathematical function keeps its name
    """cos(r) of s = r²; like the three that follow smooth at 0, for turns by a vector of length r."""


class root_sinc(sp.Function):  # noqa: N801  a mathematical function keeps its name
    """sin(r)/r of s = r²."""


class root_versine(sp.Function):  # noqa: N801  a mathematical function keeps its name
    """(1 - cos(r))/r² of s = r²."""


class root_gap(sp.Function):  # noqa: N801  a mathematical function keeps its name
    """(r - sin(r))/r³ of s = r²."""


QUATERNION = sp.symbols("qx qy qz qw", real=True)  # world_from_body of a model with a ``Rotation``
ROTATION = ("roll", "pitch", "yaw")  # the states that show it


@dataclass(frozen=True, kw_only=True)
class Rotation:
    """An attitude among the states, world_from_body, kept as the unit quaternion ``QUATERNION``: no singularity.

    The states of ``ROTATION`` show it; their covariance is that of a small turn d (rad) about the body's axes,
    q = q^ Exp(d) (Sola 2017, section 5.4). ``turn`` is the rotation vector (rad, body axes) by which it turns in dt.
    """

    turn: tuple[Expr, Expr, Expr]


@dataclass(frozen=True, kw_only=True)
class Body:
    """Where the body is and how it moves, as expressions of the state: what derived measurements are made of.

    ``position`` and ``velocity`` in the world frame (m, m/s), ``world_from_body`` a rotation matrix (3, 3),
    ``twist_linear`` and ``twist_angular`` in the body frame (m/s, rad/s), ``acceleration`` in the body frame (m/s²).
    A planar model gives 0 for what it does not have.
    """

    position: tuple[Expr, Expr, Expr]
    velocity: tuple[Expr, Expr, Expr]
    world_from_body: sp.Matrix
    twist_linear: tuple[Expr, Expr, Expr]
    twist_angular: tuple[Expr, Expr, Expr]
    acceleration: tuple[Expr, Expr, Expr] | None = None


@dataclass(frozen=True, kw_only=True)
class Model:
    """A discrete motion model x(t + dt) = f(x, u, dt) + w, declared once.

    ``states`` and ``inputs`` map names to units; a state in ``rad`` is an angle and is wrapped to (-pi, pi].
    ``transition`` gives f for every state but those of the ``rotation``. ``noise`` maps the names of the process noise
    densities to their default values; ``covariance`` gives the entries of Q(dt), by pairs of states, in those densities
    and ``DT``, so that what is added in one second does not depend on the rate. Input noise enters as B U B'/dt with
    B = df/du. ``rest`` is the input of a body that does not move, where that is not 0: it holds until the first sample.
    ``parameters`` are constants that a configuration may set, with their defaults. ``limits`` are absolute values of
    states at and beyond which there is no estimate, such as near a singularity. A model ``by_matrices`` is linear; its
    F, G and Q are numbers that a configuration gives, in place of ``transition`` and ``covariance``. ``measured`` is
    what only one sensor measures, by name, as ``with_sensor_states`` adds it.
    """

    name: str
    states: Mapping[str, str]
    transition: Mapping[str, Expr]
    noise: Mapping[str, float]
    covariance: Mapping[tuple[str, str], Expr]
    body: Body | None = None
    inputs: Mapping[str, str] = field(default_factory=dict[str, str])
    rest: Mapping[str, float] = field(default_factory=dict[str, float])
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    rotation: Rotation | None = None
    limits: Mapping[str, float] = field(default_factory=dict[str, float])
    by_matrices: bool = False
    measured: Mapping[str, Expr] = field(default_factory=dict[str, Expr])

    def __post_init__(self) -> None:
        check_model(self)

    @property
    def names(self) -> tuple[str, ...]:
        """State names, in the order of the state vector."""
        return tuple(self.states)

    @property
    def angles(self) -> tuple[bool, ...]:
        """Which states are angles."""
        return tuple(unit == "rad" for unit in self.states.values())


_FUNCTIONS = (sp.sin, sp.cos, sp.tan, sp.asin, sp.atan2, sinc, dsinc, root_cos, root_sinc, root_versine, root_gap)


class NotAModelError(FuselogError):
    """A declaration that contradicts itself, at a name in one of the model's fields."""

    def __init__(self, field: str, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.field, self.name = field, name


def check_model(model: Model) -> None:
    """Raises ``NotAModelError``: a state without transition, an unknown symbol or function, a bad entry of Q."""
    turned = ROTATION if model.rotation is not None else ()
    for name in turned:
        if name not in model.states:
            raise NotAModelError("states", name, "a model with a rotation has the states roll, pitch and yaw")
    for name in model.states:
        if name not in model.transition and name not in turned and not model.by_matrices:
            raise NotAModelError("states", name, "is a state without a transition")
    for name in model.transition:
        if name not in model.states:
            raise NotAModelError(
                "transition", name, f"has a transition but is no state (states: {', '.join(model.states)})"
            )
    for name in model.rest:
        if name not in model.inputs:
            raise NotAModelError("rest", name, "has a value at rest but is no input")
    for name, limit in model.limits.items():
        if name not in model.states or name in turned or not limit > 0:
            raise NotAModelError("limits", name, "is not a positive limit of a state")
    names = {*model.states, *model.inputs, *model.parameters}
    known = {DT, *map(symbol, names), *(QUATERNION if turned else ())}
    for name, expression in model.transition.items():
        _check_expression("transition", name, expression, known)
        for state in model.states:
            _check_derivative(name, sp.diff(sp.sympify(expression), symbol(state)))
    densities = {*known, *map(density, model.noise)}
    for (row, column), entry in model.covariance.items():
        for name in (row, column):
            if name not in model.states:
                raise NotAModelError("covariance", name, "has process noise but is no state")
        _check_expression("covariance", row, entry, densities)


def _check_expression(field: str, name: str, expression: object, known: set[sp.Symbol]) -> None:
    try:
        parsed = sp.sympify(expression)
    except (sp.SympifyError, TypeError) as error:
        raise NotAModelError(field, name, f"{expression!r} is not an expression") from error
    if not isinstance(parsed, sp.Expr):
        raise NotAModelError(field, name, f"is a {type(parsed).__name__}, not one expression")
    unknown = sorted(str(s) for s in parsed.free_symbols - known)
    if unknown:
        raise NotAModelError(field, name, f"uses {', '.join(unknown)}, which is no state, input, parameter or DT")
    foreign = sorted({type(f).__name__ for f in parsed.atoms(sp.Function) if not isinstance(f, _FUNCTIONS)})
    if foreign:
        raise NotAModelError(
            field, name, f"uses {', '.join(foreign)}; there are {', '.join(f.__name__ for f in _FUNCTIONS)}"
        )


def _check_derivative(name: str, derivative: Expr) -> None:
    if derivative.has(sp.Derivative, sp.Subs):
        raise NotAModelError("transition", name, "is not differentiable")


def rotation_matrix(quaternion: Sequence[Expr]) -> sp.Matrix:
    """The rotation (3, 3) of a unit quaternion x y z w."""
    x, y, z, w = quaternion
    return sp.Matrix(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def symbol(name: str) -> sp.Symbol:
    """The symbol of a state, an input or a parameter."""
    return sp.Symbol(name, real=True)


def symbols(names: str) -> list[sp.Symbol]:
    """Symbols of several states or inputs, in order."""
    return [symbol(name) for name in names.split()]


def density(name: str) -> sp.Symbol:
    """The symbol of the process noise density called ``name``."""
    return sp.Symbol(f"q_{name}", nonnegative=True)


def white_noise(*names: str) -> dict[tuple[str, str], Expr]:
    """Q entries of independent white noise on the named states: q dt on the diagonal."""
    return {(name, name): density(name) * DT for name in names}


def white_jerk(name: str, position: str, rate: str, push: str) -> dict[tuple[str, str], Expr]:
    """Q entries of white jerk noise of density ``name`` (m²/s⁵) on a position, its rate and acceleration (Van Loan)."""
    q = density(name)
    return {
        (position, position): q * DT**5 / 20,
        (position, rate): q * DT**4 / 8,
        (position, push): q * DT**3 / 6,
        (rate, rate): q * DT**3 / 3,
        (rate, push): q * DT**2 / 2,
        (push, push): q * DT,
    }


def white_acceleration(name: str, position: str, rate: str) -> dict[tuple[str, str], Expr]:
    """Q entries of white acceleration noise of density ``name`` (m²/s³) on a position and its rate (Van Loan)."""
    q = density(name)
    return {(position, position): q * DT**3 / 3, (position, rate): q * DT**2 / 2, (rate, rate): q * DT}
