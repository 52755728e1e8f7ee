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

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from fuselog.fusion.models.model import DT, Expr, Model, symbol
from fuselog.fusion.models.quantities import SAMPLE, SENSOR

LANES = 4  # rows of P are padded to a multiple of this many numbers


class _Printer(PythonCodePrinter):
    """Python text that numba compiles: functions by their bare names, as the kernel module imports them."""

    def _print_Function(self, expr: sp.Function) -> str:  # noqa: N802  the name is SymPy's protocol
        arguments = ", ".join(self._print(argument) for argument in expr.args)
        return f"{type(expr).__name__.lower()}({arguments})"

    _print_sinc = _print_dsinc = _print_sin = _print_cos = _print_tan = _print_atan2 = _print_Function

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:  # noqa: N802, ARG002  SymPy's protocol
        base, exponent = expr.as_base_exp()
        twice = 2 * exponent
        if not twice.is_Integer or abs(int(twice)) > 8:
            return f"({self._print(base)}) ** ({self._print(exponent)})"
        whole, half = divmod(abs(int(twice)), 2)
        power = " * ".join([f"({self._print(base)})"] * whole + [f"sqrt({self._print(base)})"] * half)
        return f"({power})" if twice > 0 else f"(1.0 / ({power}))"


def generate(model: Model, measured: Mapping[str, Expr]) -> str:
    """The text of constants, ``predict`` and ``observe`` for a model and the quantities that its sensors measure."""
    n = len(model.states)
    width = max([1, *(len(_dependence(model, expression)) for expression in measured.values())])
    head = [
        f"N = {n}  # {' '.join(model.names)}",
        f"LD = {-(-n // LANES) * LANES}  # numbers from one row of P to the next",
        f"U = {len(model.inputs)}  # {' '.join(model.inputs) or 'no inputs'}",
        f"WIDTH = {width}  # most states that one measured number depends on",
        f"ANGLES = np.array({[int(a) for a in model.angles]}, np.uint8)",
    ]
    return "\n".join([*head, "", "", *_predict(model), "", "", *_observe(model, measured), ""])


def _dependence(model: Model, expression: Expr) -> list[int]:
    return [i for i, name in enumerate(model.names) if symbol(name) in expression.free_symbols]


def _predict(model: Model) -> list[str]:
    names, n = model.names, len(model.states)
    states = [symbol(name) for name in names]
    after = sp.Matrix([model.transition[name] for name in names])
    F = after.jacobian(states)
    off = [(i, j) for i in range(n) for j in range(n) if F[i, j] != (1 if i == j else 0)]
    Q = _process_noise(model, after)
    entries = [*after, *(F[i, j] for i, j in off), *Q.values()]
    shared, results = _share(model, entries)
    moved, jacobian, noise = results[:n], results[n : n + len(off)], results[n + len(off) :]
    body = [
        "def predict(s, a, b, dt, q, w):",
        '    """State row b from row a after dt: x = f(x, u, dt), P = F P F\' + Q. w is scratch of 2 LD LD numbers."""',
        *(f"    x_{name} = s[a + {i}]" for i, name in enumerate(names)),
        *(f"    u_{name} = s[b + INPUT + {i}]" for i, name in enumerate(model.inputs)),
        *(f"    U_{name} = s[b + INPUT + U + {i}]" for i, name in enumerate(model.inputs)),
        *(f"    q_{name} = q[{i}]" for i, name in enumerate(model.noise)),
        *(f"    {name} = {_text(value)}" for name, value in shared),
        *(f"    F_{i}_{j} = {_text(value)}" for (i, j), value in zip(off, jacobian, strict=True)),
        *_product("w", "0", "s", "a + COVARIANCE", off, n, upper=False),
        "    transpose(w, LD * LD, w, 0, LD)",
        *_product("s", "b + COVARIANCE", "w", "LD * LD", off, n, upper=True),
        *(f"    s[b + COVARIANCE + {i} * LD + {j}] += {_text(value)}" for (i, j), value in zip(Q, noise, strict=True)),
        "    mirror(s, b + COVARIANCE, LD)",
        *(
            f"    s[b + {i}] = {'wrap(' + _text(value) + ')' if model.angles[i] else _text(value)}"
            for i, value in enumerate(moved)
        ),
    ]
    return _used(body)


def _process_noise(model: Model, after: sp.Matrix) -> dict[tuple[int, int], Expr]:
    """Non-zero entries of Q on and above the diagonal: the model's own, and B diag(u) B'/dt of the inputs' noise."""
    index = {name: i for i, name in enumerate(model.names)}
    Q = sp.zeros(len(index))
    for (row, column), entry in model.covariance.items():
        i, j = index[row], index[column]
        Q[i, j] += entry
        if i != j:
            Q[j, i] += entry
    if model.inputs:
        B = after.jacobian([symbol(name) for name in model.inputs])
        root = B.applyfunc(lambda entry: sp.expand(entry / DT))
        U = sp.diag(*(sp.Symbol(f"U_{name}", nonnegative=True) for name in model.inputs))
        Q += (root * U * root.T) * DT
    return {(i, j): Q[i, j] for i in range(Q.rows) for j in range(i, Q.cols) if Q[i, j] != 0}


def _product(
    out: str, to: str, source: str, at: str, off: Iterable[tuple[int, int]], n: int, *, upper: bool
) -> list[str]:
    """Lines for out = F source, row by row; of a symmetric product only from the block of the diagonal on."""
    off, lines, width = set(off), [], -(-n // LANES) * LANES
    for i in range(n):
        column = i // LANES * LANES if upper else 0
        terms = {i: "1.0"} | {j: f"F_{k}_{j}" for k, j in sorted(off) if k == i}
        starts = "".join(f"{at} + {j} * LD + {column}, " for j in terms)
        factors = "".join(f"{factor}, " for factor in terms.values())
        place = f"{to} + {i} * LD + {column}"
        lines.append(f"    row_sum({out}, {place}, {source}, ({starts}), ({factors}), {width - column})")
    return lines


def _observe(model: Model, measured: Mapping[str, Expr]) -> list[str]:
    lines = [
        "def observe(row, s, a, par, p, z, za, hv, hi, k):",
        '    """Quantity number ``row`` at the state s[a:]: returns h and how many derivatives it left in hv, hi."""',
    ]
    for number, expression in enumerate(measured.values()):
        dependence = _dependence(model, expression)
        derivatives = [sp.diff(expression, symbol(model.names[i])) for i in dependence]
        shared, (value, *slopes) = _share(model, [expression, *derivatives])
        used = {str(s) for s in expression.free_symbols}
        lines += [
            f"    if row == {number}:",
            *(f"        x_{name} = s[a + {i}]" for i, name in enumerate(model.names) if name in used),
            *(f"        u_{name} = s[a + INPUT + {i}]" for i, name in enumerate(model.inputs) if name in used),
            *(f"        {s} = par[p + {i}]" for i, s in enumerate(SENSOR) if str(s) in used),
            *(f"        {s} = z[za + {i}]" for i, s in enumerate(SAMPLE) if str(s) in used),
            *(f"        {name} = {_text(part)}" for name, part in shared),
            *(f"        hi[k + {i}] = {column}" for i, column in enumerate(dependence)),
            *(f"        hv[k + {i}] = {_text(slope)}" for i, slope in enumerate(slopes)),
            f"        return {_text(value)}, {len(dependence)}",
        ]
    return [*lines, "    return 0.0, 0"]


def _share(model: Model, entries: list[Expr]) -> tuple[list[tuple[sp.Symbol, Expr]], list[Expr]]:
    """Common subexpressions and what is left of the entries, in names that no state can clash with."""
    local = {symbol(name): sp.Symbol(f"x_{name}", real=True) for name in model.names}
    local |= {symbol(name): sp.Symbol(f"u_{name}", real=True) for name in model.inputs}
    shared, rest = sp.cse([entry.xreplace(local) for entry in entries], sp.numbered_symbols("t"))
    return shared, [sp.sympify(entry) for entry in rest]


def _used(lines: Sequence[str]) -> list[str]:
    """The lines without assignments of plain names that no later line reads."""
    kept: list[str] = []
    for number, line in enumerate(lines):
        name = line.strip().partition(" = ")[0]
        rest = "\n".join(lines[number + 1 :])
        if not any(read in line for read in (" = s[a + ", " = s[b + INPUT", " = q[")) or any(
            name == word for word in _words(rest)
        ):
            kept.append(line)
    return kept


def _words(text: str) -> set[str]:
    return set("".join(c if c.isalnum() or c == "_" else " " for c in text).split())


def _text(expression: Expr) -> str:
    return str(_Printer({"fully_qualified_modules": False}).doprint(expression))
