"""What writing a function out may not change: the value, and what a name means."""

from pathlib import Path

import pytest
from tests.fusion.setups import setup

from fuselog.fusion.kernel.inlining import write_out

HEAD = """
def inline(function):
    return function

def twice(x):
    return 2 * x
"""
CASES = {  # functions, how many of them stay, and what main() gives
    "a statement": (
        "@inline\ndef put(to, x):\n    y = x + 1\n    to[0] = y\n",
        "    y, a = 5, [0]\n    put(a, y)\n    return a[0], y",
        0,
        (6, 5),
    ),
    "a value": (
        "@inline\ndef more(x):\n    x = x + 1\n    return x\n",
        "    x = 3\n    z = more(x)\n    return z, x",
        0,
        (4, 3),
    ),
    "a chain": (
        "@inline\ndef one(x):\n    y = x + 1\n    return y\n\n@inline\ndef two(x):\n    y = one(x)\n    return y * y\n",
        "    y = two(2)\n    return y",
        0,
        9,
    ),
    "a name that means something else there": (
        "@inline\ndef four(x):\n    return twice(x)\n",
        "    twice = 7\n    z = four(2)\n    return z + twice",
        1,
        11,
    ),
    "an early return": (
        "@inline\ndef sign(x):\n    if x < 0:\n        return -1\n    return 1\n",
        "    z = sign(-2)\n    return z",
        1,
        -1,
    ),
    "two calls": ("@inline\ndef more(x):\n    return x + 1\n", "    a = more(1)\n    b = more(a)\n    return b", 1, 3),
    "inside an expression": ("@inline\ndef more(x):\n    return x + 1\n", "    return 2 * more(1)", 1, 4),
}


@pytest.mark.parametrize("case", CASES)
def test_written_out_it_means_the_same(case: str) -> None:
    functions, body, left, expected = CASES[case]
    text = write_out(f"{HEAD}\n{functions}\ndef main():\n{body}\n")
    scope: dict[str, object] = {}
    exec(text, scope)
    assert scope["main"]() == expected  # type: ignore[operator]
    assert text.count("@inline") == left


@pytest.mark.parametrize(("case", "marked"), [("an early return", 1), ("inside an expression", 1), ("two calls", 0)])
def test_what_is_called_once_is_marked_where_that_is_wanted(case: str, marked: int) -> None:
    functions, body, left, expected = CASES[case]
    text = write_out(f"{HEAD}\nonce = inline\n{functions}\ndef main():\n{body}\n", embed=True)
    scope: dict[str, object] = {}
    exec(text, scope)
    assert scope["main"]() == expected  # type: ignore[operator]
    assert (text.count("@once"), text.count("@inline")) == (marked, left - marked)


@pytest.mark.parametrize(("model", "small"), [("constant_velocity", True), ("unicycle", False)])
def test_kernels_of_small_models_are_made_otherwise(model: str, small: bool) -> None:
    """Addresses are not held, and calls are put in their place where several filters go together, too."""
    plan = setup(model)
    alone, several = (Path(str(kernel.__file__)).read_text() for kernel in (plan.kernel, plan.abreast))
    assert "@once" in alone
    assert ("@once" in several) is small
    assert ("held_record_at as record_at" in alone) is not small
