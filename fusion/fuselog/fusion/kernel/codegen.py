"""From a symbolic model to the text of two straight-line kernels, ``predict`` and ``observe``.

This is steps 1 and 2 of Bezmen's cycle done by the machine: f and its Jacobian, h and its Jacobian, with common
subexpressions shared and zeros left out.
"""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false
# pyright: reportUnknownLambdaType=false, reportConstantRedefinition=false, reportReturnType=false

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import sympy as sp

from fuselog.fusion.kernel.printing import assignments, needed, text, tuple_text, word
from fuselog.fusion.models.model import (
    DT,
    QUATERNION,
    ROTATION,
    Expr,
    Model,
    root_cos,
    root_gap,
    root_sinc,
    root_versine,
    symbol,
)
from fuselog.fusion.models.quantities import SAMPLE, SENSOR, combination_factors, is_factor

MULTIPLE = 4  # rows of P are padded to a multiple of this many numbers


def generate(model: Model, measured: Mapping[str, Expr]) -> str:
    """The text of constants and of the functions of ``blank``, for a model and what is measured.

    A model by matrices has a ``predict`` and its parts already.
    """
    n, stored = len(model.states), len(_stored(model))
    width = max([1, *(_width(model, expression) for expression in measured.values())])
    head = [
        f"N = {n}  # {' '.join(map(_shown, model.names))}",
        f"LD = {_padded(n)}  # numbers from one row of P to the next",
        f"X = {_padded(stored)}  # numbers of x as it is kept",
        f"U = {len(model.inputs)}  # {' '.join(model.inputs) or 'no inputs'}",
        f"DENSITIES = {len(model.noise)}  # of the process noise, the first numbers of q",
        f"WIDTH = {width}  # most states that one measured number depends on",
        f"ANGLES = np.array({[int(a) for a in model.angles]}, np.uint8)",
        f"LIMITED = {bool(model.limits)}  # whether a state has a limit",
        f"LIMITS = np.array([{', '.join(_limit(model, name) for name in model.names)}])",
        f"ROTATION = {model.names.index(ROTATION[0]) if model.rotation else -1}  # where roll, pitch, yaw stand",
    ]
    parts = [_inject(model), _observe(model, measured)]
    if not model.by_matrices:
        texts = _texts(model)
        head += [
            f"FORTH = congruence({_sparse(texts.F, n)})  # F P F'",
            f"BACK = congruence({_sparse([(j, i) for i, j in texts.F], n)})  # F' P F",
            f"NOISE = increase({_noisy(texts.Q, n)})  # P + Q",
        ]
        parts = [*_moves(model, texts), *parts]
    return "\n".join([*head, *(line for part in parts for line in ("", "", *part)), ""])


def _limit(model: Model, name: str) -> str:
    return repr(float(model.limits[name])) if name in model.limits else "np.inf"


def _shown(name: str) -> str:
    return name if name.isprintable() else word(name)


def _padded(n: int) -> int:
    return -(-n // MULTIPLE) * MULTIPLE


def _stored(model: Model) -> list[sp.Symbol]:
    """The symbols of the numbers of x as it is kept: the states, and the quaternion behind them."""
    return [*(symbol(name) for name in model.names), *(QUATERNION if model.rotation else ())]


def _plain(model: Model) -> list[str]:
    """The states that are what they are: all but those of the rotation."""
    return [name for name in model.names if model.rotation is None or name not in ROTATION]


def _product_of(p: Sequence[Expr], q: Sequence[Expr]) -> list[Expr]:
    """The quaternion p q, both x y z w."""
    return [
        p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1],
        p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0],
        p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3],
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    ]


def _slopes(model: Model, expression: Expr) -> dict[str, Expr]:
    """The derivative with respect to each state; to the states of the rotation, by a small turn d: q Exp(d).

    Where an expression names roll, pitch or yaw of a rotation itself, it stands for the turn about that body axis.
    """
    found = {name: sp.diff(expression, symbol(name)) for name in _plain(model)}
    for axis, name in enumerate(ROTATION if model.rotation else ()):
        turn = [sp.Rational(1, 2) if i == axis else sp.Integer(0) for i in range(3)]
        change = _product_of(QUATERNION, [*turn, sp.Integer(0)])
        by_turn = (sp.diff(expression, q) * d for q, d in zip(QUATERNION, change, strict=True))
        found[name] = sum(by_turn, sp.diff(expression, symbol(name)))
    return {name: found[name] for name in model.names if found[name] != 0}


def _dependence(model: Model, expression: Expr) -> list[int]:
    slopes = _slopes(model, expression)
    return [i for i, name in enumerate(model.names) if name in slopes]


def _width(model: Model, expression: Expr) -> int:
    """On how many states it depends; on a turn about all axes where it does about one."""
    found = {model.names[i] for i in _dependence(model, expression)}
    turned = {*ROTATION} if model.rotation is not None and found & {*ROTATION} else set[str]()
    return len(found | turned)


def _cross(v: Sequence[Expr]) -> sp.Matrix:
    """The matrix (3, 3) of the cross product with v from the left."""
    return sp.Matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


@dataclass(frozen=True)
class _Motion:
    """A transition in parts: what x becomes as it is kept, its derivatives, and those with respect to the inputs."""

    moved: dict[str, Expr]  # by state, or name of the quaternion's number
    slopes: dict[tuple[str, str], Expr]  # F
    driven: dict[tuple[str, str], Expr]  # B: by state and input


def _motion(model: Model) -> _Motion:
    inputs = [symbol(name) for name in model.inputs]
    moved = {name: sp.sympify(model.transition[name]) for name in _plain(model)}
    slopes = {(row, name): slope for row in moved for name, slope in _slopes(model, moved[row]).items()}
    driven = {(row, str(u)): sp.diff(moved[row], u) for row in moved for u in inputs}
    if model.rotation is not None:
        turn = sp.Matrix(model.rotation.turn)
        square = turn.dot(turn)
        across = _cross(turn)
        # Sola 2017, equations 145, 183: what a turn before becomes after, and what a change of the turn does
        carried = sp.eye(3) - root_sinc(square) * across + root_versine(square) * across * across
        right = sp.eye(3) - root_versine(square) * across + root_gap(square) * across * across
        for i, row in enumerate(ROTATION):
            by_state: dict[str, Expr] = {name: carried[i, j] for j, name in enumerate(ROTATION)}
            for j in range(3):
                for name, slope in _slopes(model, turn[j]).items():
                    by_state[name] = by_state.get(name, sp.Integer(0)) + right[i, j] * slope
            slopes |= {(row, name): slope for name, slope in by_state.items()}
            for u in inputs:
                driven[row, str(u)] = sum((right[i, j] * sp.diff(turn[j], u) for j in range(3)), sp.Integer(0))
        half = [root_sinc(square / 4) * part / 2 for part in turn]
        after = _product_of(QUATERNION, [*half, root_cos(square / 4)])
        moved |= {str(q): part for q, part in zip(QUATERNION, after, strict=True)}
    return _Motion(moved, slopes, driven)


@dataclass(frozen=True)
class _Texts:
    """A transition as text: how it begins, what x becomes, and the entries of F (not those of I) and Q (upper)."""

    head: list[str]
    moved: dict[str, str]
    F: dict[tuple[int, int], str]
    Q: dict[tuple[int, int], str]


def _texts(model: Model) -> _Texts:
    n, motion = len(model.states), _motion(model)
    index = {name: i for i, name in enumerate(model.names)}
    F = {(index[row], index[name]): slope for (row, name), slope in motion.slopes.items()}
    off = [(i, j) for i in range(n) for j in range(n) if F.get((i, j), 0) != (1 if i == j else 0)]
    Q = _process_noise(model, motion)
    entries = [*motion.moved.values(), *(F.get(place, sp.Integer(0)) for place in off), *Q.values()]
    shared, results = _share(model, entries)
    moved = dict(zip(motion.moved, results, strict=False))
    jacobian, noise = results[len(moved) : len(moved) + len(off)], results[len(moved) + len(off) :]
    head = [
        *(f"    {word(f'x_{name}')} = s[a + {i}]" for i, name in enumerate(map(str, _stored(model)))),
        *(f"    u_{name} = s[b + INPUT + {i}]" for i, name in enumerate(model.inputs)),
        *(f"    U_{name} = s[b + INPUT + U + {i}]" for i, name in enumerate(model.inputs)),
        *(f"    {word(f'q_{name}')} = q[{i}]" for i, name in enumerate(model.noise)),
        *(f"    p_{name} = q[{len(model.noise) + i}]" for i, name in enumerate(model.parameters)),
        *(f"    {line}" for line in assignments(shared)),
    ]
    return _Texts(
        head,
        {name: text(value) for name, value in moved.items()},
        {place: text(value) for place, value in zip(off, jacobian, strict=True)},
        {place: text(value) for place, value in zip(Q, noise, strict=True)},
    )


def _moves(model: Model, texts: _Texts) -> list[list[str]]:
    return [_predict(model, texts), _move(model, texts), _disturb(texts), _linearise(texts), _adjoin(model, texts)]


def _predict(model: Model, texts: _Texts) -> list[str]:
    n = len(model.states)
    off = {(i, j): f"F_{i}_{j}" for i, j in texts.F}
    body = [
        "def predict(s, a, b, dt, q, w):",
        '    """State row b from row a after dt: x = f(x, u, dt), P = F P F\' + Q. w is scratch of 2 LD LD numbers.',
        "",
        "    P is symmetric but for rounding.",
        '    """',
        *texts.head,
        *(f"    F_{i}_{j} = {value}" for (i, j), value in texts.F.items()),
        f"    FORTH(s, b + COVARIANCE, s, a + COVARIANCE, w, {tuple_text(_entries(off, n))}, LD)",
        *_add_noise(texts.Q, n),
        *_arrive(model, texts),
    ]
    return needed(body)


def _move(model: Model, texts: _Texts) -> list[str]:
    body = [
        "def move(s, a, b, dt, q):",
        '    """The x of state row b from row a after dt, as ``predict``."""',
        *texts.head,
        *_arrive(model, texts),
    ]
    return needed(body)


def _arrive(model: Model, texts: _Texts) -> list[str]:
    """Lines that write the x of state row b."""
    stored = list(map(str, _stored(model)))
    row = [texts.moved.get(name, "0.0") for name in stored]  # none has roll, pitch and yaw of a rotation
    row = [f"wrap({value})" if angle else value for value, angle in zip_longest(row, model.angles)]
    return [
        f"    row_put(s, b, {tuple_text([*row, *['0.0'] * (_padded(len(row)) - len(row))])})",
        *(["    show_rotation(s, b + N, b + ROTATION)"] if model.rotation else []),
    ]


def _disturb(texts: _Texts) -> list[str]:
    body = [
        "def disturb(s, a, b, dt, q):",
        '    """Add the Q of ``predict`` to P of state row b, on and above the diagonal."""',
        *texts.head,
        *(f"    s[b + COVARIANCE + {i} * LD + {j}] += {value}" for (i, j), value in texts.Q.items()),
    ]
    return needed(body)


def _add_noise(Q: Mapping[tuple[int, int], str], n: int) -> list[str]:
    """P += Q."""
    lines = [f"    Q_{i}_{j} = {value}" for (i, j), value in Q.items()]
    numbers = [f"Q_{min(i, j)}_{max(i, j)}" for i, columns in enumerate(_noisy(Q, n)) for j in columns]
    return [*lines, f"    NOISE(s, b + COVARIANCE, {tuple_text(numbers)}, LD)"] if Q else []


def _noisy(Q: Iterable[tuple[int, int]], n: int) -> list[list[int]]:
    """The columns of each row of Q that are not 0."""
    both = {*Q} | {(j, i) for i, j in Q}
    return [[j for j in range(n) if (i, j) in both] for i in range(n)]


def _sparse(off: Iterable[tuple[int, int]], n: int) -> list[list[int]]:
    """The columns of each row of F, given the places where it is not I; none where the row is."""
    changed = {i for i, _ in off}
    return [[i, *sorted(j for k, j in off if k == i != j)] if i in changed else [] for i in range(n)]


def _entries(off: Mapping[tuple[int, int], str], n: int) -> list[str]:
    """What is there, row by row."""
    return [off.get((i, j), "1.0") for i, columns in enumerate(_sparse(off, n)) for j in columns]


def _linearise(texts: _Texts) -> list[str]:
    body = [
        "def linearise(s, a, b, dt, q, F, Q):",
        '    """F (I before) and Q (0 before), rows of N numbers, of ``predict`` from row a, input in row b."""',
        *texts.head,
        *(f"    F[{i} * N + {j}] = {value}" for (i, j), value in texts.F.items()),
        *(f"    Q[{i} * N + {j}] = {value}" for (i, j), value in texts.Q.items()),
        *(f"    Q[{j} * N + {i}] = Q[{i} * N + {j}]" for i, j in texts.Q if i != j),
    ]
    return needed(body)


def _adjoin(model: Model, texts: _Texts) -> list[str]:
    n = len(model.states)
    turned = {(j, i): f"F_{i}_{j}" for i, j in texts.F}
    rows = {i: {i: "1.0"} | {j: factor for (k, j), factor in sorted(turned.items()) if k == i} for i, _ in turned}
    body = [
        "def adjoin(s, a, b, dt, q, A, w):",
        '    """F\' A F in place of A and F\' l of the row l behind it, by F of ``predict``.',
        "",
        "    w is scratch of 3 LD LD numbers.",
        '    """',
        *texts.head,
        *(f"    F_{i}_{j} = {value}" for (i, j), value in texts.F.items()),
        f"    BACK(w, 2 * LD * LD, A, 0, w, {tuple_text(_entries(turned, n))}, LD)",
        "    for i in range(LD):",
        "        row_copy(A, i * LD, w, (2 * LD + i) * LD, LD)",
        "    mirror(A, 0, LD)",
        *(
            f"    l_{i} = " + " + ".join(f"{factor} * A[LD * LD + {j}]" for j, factor in terms.items())
            for i, terms in rows.items()
        ),
        *(f"    A[LD * LD + {i}] = l_{i}" for i in rows),
    ]
    return needed(body)


def _inject(model: Model) -> list[str]:
    """x = x (+) d: added, angles wrapped, the attitude turned."""
    lines = ["def inject(s, a, w, d):", '    """Correct the x of state row a by the N numbers w[d:]."""']
    if model.rotation is None:
        wrapped = [f"    wrap_at(s, a + {i})" for i, turns in enumerate(model.angles) if turns]
        return [*lines, "    row_add(s, a, w, d, 1.0, LD)", *wrapped]
    for i, name in enumerate(model.names):
        if name in _plain(model):
            moved = f"s[a + {i}] + w[d + {i}]"
            lines.append(f"    s[a + {i}] = {f'wrap({moved})' if model.angles[i] else moved}")
    return [*lines, "    turn_rotation(s, a + N, w, d + ROTATION)", "    show_rotation(s, a + N, a + ROTATION)"]


def _process_noise(model: Model, motion: _Motion) -> dict[tuple[int, int], Expr]:
    """Non-zero entries of Q on and above the diagonal: the model's own, and B diag(u) B'/dt of the inputs' noise."""
    index = {name: i for i, name in enumerate(model.names)}
    Q = sp.zeros(len(index))
    for (row, column), entry in model.covariance.items():
        i, j = index[row], index[column]
        Q[i, j] += entry
        if i != j:
            Q[j, i] += entry
    if model.inputs:
        U = [sp.Symbol(f"U_{name}", nonnegative=True) for name in model.inputs]
        roots = [
            [sp.expand(motion.driven.get((name, u), sp.Integer(0)) / DT) for u in model.inputs] for name in model.names
        ]
        Q += sp.Matrix(
            len(index),
            len(index),
            lambda i, j: sum((roots[i][k] * roots[j][k] * u for k, u in enumerate(U)), sp.Integer(0)) * DT,
        )
    return {(i, j): Q[i, j] for i in range(Q.rows) for j in range(i, Q.cols) if Q[i, j] != 0}


def _observe(model: Model, measured: Mapping[str, Expr]) -> list[str]:
    lines = [
        "def observe(row, s, a, par, p, z, za, q, hv, hi, k):",
        '    """Quantity number ``row`` at the state s[a:]: returns h and how many derivatives it left in hv, hi."""',
    ]
    index = {name: i for i, name in enumerate(model.names)}
    place = {factor: _constants(model) + i for i, factor in enumerate(_factors(measured))}
    for number, expression in enumerate(measured.values()):
        slopes = _slopes(model, expression)
        shared, (value, *rest) = _share(model, [expression, *slopes.values()])
        used = {str(s) for part in (expression, *slopes.values()) for s in part.free_symbols}
        lines += [
            f"    if row == {number}:",
            *(f"        {word(f'x_{n}')} = s[a + {i}]" for i, n in enumerate(map(str, _stored(model))) if n in used),
            *(f"        u_{name} = s[a + INPUT + {i}]" for i, name in enumerate(model.inputs) if name in used),
            *(f"        p_{n} = q[{len(model.noise) + i}]" for i, n in enumerate(model.parameters) if n in used),
            *(f"        {_local(f)} = q[{at}]" for f, at in place.items() if str(f) in used),
            *(f"        {s} = par[p + {i}]" for i, s in enumerate(SENSOR) if str(s) in used),
            *(f"        {s} = z[za + {i}]" for i, s in enumerate(SAMPLE) if str(s) in used),
            *(f"        {line}" for line in assignments(shared)),
            *(f"        hi[k + {i}] = {index[name]}" for i, name in enumerate(slopes)),
            *(f"        hv[k + {i}] = {text(slope)}" for i, slope in enumerate(rest)),
            f"        return {text(value)}, {len(slopes)}",
        ]
    return [*lines, "    return 0.0, 0"]


def _constants(model: Model) -> int:
    """How many numbers of q are the model's."""
    n, u = len(model.states), len(model.inputs)
    return 1 + n * (n + u) + n * n if model.by_matrices else len(model.noise) + len(model.parameters)


def _factors(measured: Mapping[str, Expr]) -> list[sp.Symbol]:
    """The factors of linear combinations, in the order of ``combination_factors``."""
    found = {str(s): s for expression in measured.values() for s in expression.free_symbols if is_factor(s)}
    return [found[name] for name in combination_factors(list(measured))]


def _local(factor: sp.Symbol) -> str:
    return str(factor).replace(" ", "_")


def _share(model: Model, entries: list[Expr]) -> tuple[list[tuple[sp.Symbol, Expr]], list[Expr]]:
    """Common subexpressions and what is left of the entries, in names that no state can clash with."""
    local = {one: sp.Symbol(f"x_{one}", real=True) for one in _stored(model)}
    local |= {symbol(name): sp.Symbol(f"u_{name}", real=True) for name in model.inputs}
    local |= {symbol(name): sp.Symbol(f"p_{name}", real=True) for name in model.parameters}
    local |= {s: sp.Symbol(_local(s), real=True) for entry in entries for s in entry.free_symbols if is_factor(s)}
    shared, rest = sp.cse([entry.xreplace(local) for entry in entries], sp.numbered_symbols("t"))
    return shared, [sp.sympify(entry) for entry in rest]
