"""Symbolic expressions as lines of Python that numba compiles."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false
# pyright: reportUnknownLambdaType=false, reportReturnType=false

import re
from collections.abc import Iterable, Iterator, Sequence

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from fuselog.fusion.models.model import Expr


class _Printer(PythonCodePrinter):
    """Python text that numba compiles: functions by their bare names, as the kernel module imports them."""

    def _print_Function(self, expr: sp.Function) -> str:  # noqa: N802  the name is SymPy's protocol
        arguments = ", ".join(self._print(argument) for argument in expr.args)
        return f"{type(expr).__name__.lower()}({arguments})"

    def _print_Symbol(self, expr: sp.Symbol) -> str:  # noqa: N802  the same
        return word(expr.name)

    _print_sinc = _print_dsinc = _print_sin = _print_cos = _print_tan = _print_asin = _print_atan2 = _print_Function

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:  # noqa: N802, ARG002  SymPy's protocol
        base, exponent = expr.as_base_exp()
        twice = 2 * exponent
        if not twice.is_Integer or abs(int(twice)) > 8:
            return f"({self._print(base)}) ** ({self._print(exponent)})"
        whole, half = divmod(abs(int(twice)), 2)
        power = " * ".join([f"({self._print(base)})"] * whole + [f"sqrt({self._print(base)})"] * half)
        return f"({power})" if twice > 0 else f"(1.0 / ({power}))"


def word(name: str) -> str:
    """A name as Python takes it: what is no letter, digit or underscore by its code."""
    return re.sub(r"\W", lambda match: f"_{ord(match[0]):x}_", name)


def text(expression: Expr) -> str:
    """An expression."""
    return str(_Printer({"fully_qualified_modules": False}).doprint(expression))


def tuple_text(values: Iterable[str]) -> str:
    """A tuple of what these texts are."""
    return f"({''.join(f'{value}, ' for value in values)})"


def assignments(shared: Sequence[tuple[sp.Symbol, Expr]]) -> Iterator[str]:
    """Lines that give common subexpressions their names; sine and cosine of an angle, or of three, together."""
    names, given = {value: name for name, value in shared}, set[sp.Symbol]()
    angles = list(dict.fromkeys(value.args[0] for _, value in shared if value.func in (sp.sin, sp.cos)))
    pairs = {angle: (names.get(sp.sin(angle)), names.get(sp.cos(angle))) for angle in angles}
    known = [angle for angle in angles if None not in pairs[angle] and not angle.free_symbols & {*names.values()}]
    for three in zip(*[iter(known)] * 3, strict=False):
        found = [name for angle in three for name in pairs[angle]]
        yield f"{', '.join(map(str, found))} = three_sin_cos({', '.join(map(text, three))})"
        given |= {*found}
    for name, value in shared:
        sine, cosine = pairs[value.args[0]] if value.func in (sp.sin, sp.cos) else (None, None)
        if sine is None or cosine is None:
            yield f"{name} = {text(value)}"
        elif name not in given:
            yield f"{sine}, {cosine} = sin_cos({text(value.args[0])})"
            given |= {sine, cosine}


def needed(lines: Sequence[str]) -> list[str]:
    """The lines without assignments of plain names that no later line reads."""
    kept, read = list[str](), set[str]()
    for line in reversed(lines):
        name, assigns, _ = line.strip().partition(" = ")
        names = name.split(", ")
        if not assigns or not all(map(str.isidentifier, names)) or read & {*names}:
            kept.append(line)
            read |= _words(line)
    return kept[::-1]


def _words(text: str) -> set[str]:
    return set("".join(c if c.isalnum() or c == "_" else " " for c in text).split())
