"""Generated kernels and model cards, kept in the user's cache folder so that SymPy and the compiler run once."""

import ast
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

from fuselog.fusion.kernel.declared import Declaration
from fuselog.fusion.kernel.fit import Fit
from fuselog.fusion.kernel.inlining import write_out
from fuselog.fusion.kernel.small import SMALL
from fuselog.schemas.errors import FuselogError

_HERE = Path(__file__).parent
_HELD = "import record_at\n", "import held_record_at as record_at\n"  # for models that are not small
_LANES = {  # for several filters
    "import record_at\n": "import lanes_at as record_at\n",
    " three_sin_cos,": " three_sin_cos_of_lanes as three_sin_cos,",
}
# the texts that are compiled together with a generated model, as one module that takes the model's names
_BEFORE = ("layout", "innovation", "moments", "seeding", "correction", "soundness")
_FILTERS = {"ekf": "extended", "iekf": "iterated", "ukf": "unscented"}  # of which one comes between
# parts and, where nothing needs them, what is in their place, as they take time
_CAREFUL, _PLAIN = ("robust", "standstill"), ("plain",)
_WEIGHED, _OPTIMAL = ("schedule", "gains"), ("optimal",)
_AFTER = ("step", "alone", "advance", "linear", "smooth")
_ABREAST = ("step", "abreast", "advance")  # instead, in a kernel that moves several filters
_SOURCES = (_HERE, _HERE.parent / "models")  # what a kernel is made of
_OWN = {
    f"fuselog.fusion.kernel.{n}"
    for n in ("blank", *_BEFORE, *_FILTERS.values(), *_CAREFUL, *_PLAIN, *_WEIGHED, *_OPTIMAL, *_AFTER, *_ABREAST)
}
_HEAD = '''"""Made by fuselog from the model {name}; delete freely."""

import math
from math import sqrt

import numpy as np

from fuselog.fusion.kernel.scalars import (
    asin,
    atan2,
    cos,
    dsinc,
    root_cos,
    root_gap,
    root_sinc,
    root_versine,
    sin,
    sin_cos,
    sinc,
    tan,
    three_sin_cos,
    wrap,
    wrap_at,
)
from fuselog.fusion.kernel.rotations import right_jacobian, settle_rotation, show_rotation, turn_between, turn_rotation
from fuselog.fusion.kernel.rows import row_add, row_copy, row_put
from fuselog.fusion.kernel.squares import congruence, increase, mirror
from fuselog.schemas.compiled import inline, once

'''


@dataclass(frozen=True, kw_only=True)
class ModelCard:
    """What a configuration needs to know of a model, without its equations."""

    name: str
    states: dict[str, str]  # name: unit
    inputs: dict[str, str]  # name: unit
    noise: dict[str, float]  # density: default
    rest: dict[str, float]  # input: its value for a body that does not move
    parameters: dict[str, float]  # name: default
    quantities: list[str]  # what sensors may measure besides states
    has_pose: bool  # whether an Odometry says what the state says
    limits: dict[str, float]  # state: absolute value from which on there is no estimate
    rotates: bool  # whether roll, pitch, yaw are one rotation, with the covariance of a small turn about body axes


def cache_folder() -> Path:
    """Where compiled kernels are kept: ``FUSELOG_CACHE_DIR``, or the user's cache folder."""
    named = os.environ.get("FUSELOG_CACHE_DIR")
    base = Path(named) if named else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fuselog"
    return base / "kernels"


def model_card(declared: Declaration) -> ModelCard:
    """The card of a model; derives it from the symbolic model when the cache does not have it."""
    path = cache_folder() / _key(declared) / "card.json"
    if path.is_file():
        return ModelCard(**json.loads(path.read_text()))
    from fuselog.fusion.models.quantities import measurable  # noqa: PLC0415  SymPy takes seconds; only on a cache miss

    model = declared.declare()
    place = ("x", "y", "yaw") if model.rotation is None else ("x", "y", "z")
    pose = all(state in model.states for state in place)
    card = ModelCard(
        name=model.name,
        states=dict(model.states),
        inputs=dict(model.inputs),
        noise=dict(model.noise),
        rest={name: model.rest.get(name, 0.0) for name in model.inputs},
        parameters=dict(model.parameters),
        quantities=list(measurable(model)),
        has_pose=pose,
        limits=dict(model.limits),
        rotates=model.rotation is not None,
    )
    _store(path, json.dumps(asdict(card)))
    return card


def kernel_module(
    declared: Declaration, measured: Sequence[str], kind: str, fit: Fit, *, abreast: bool = False
) -> ModuleType:
    """The module with ``advance`` for a model, what its sensors measure, in this order, and the kind of filter.

    ``abreast``: it moves ``LANES`` filters at once.
    """
    key = _key(declared, *measured, kind, repr(fit), "abreast" if abreast else "alone")
    path = cache_folder() / key / f"{declared.function}.py"
    if not path.is_file():
        from fuselog.fusion.kernel.codegen import generate  # noqa: PLC0415  SymPy takes seconds; only on a cache miss
        from fuselog.fusion.models.quantities import combination, is_combination, measurable  # noqa: PLC0415  the same

        model = declared.declare()
        available = measurable(model)
        generated = generate(model, {q: combination(q) if is_combination(q) else available[q] for q in measured})
        texts = (
            *(("matrices",) if model.by_matrices else ()),
            *_BEFORE,
            *(_WEIGHED if fit.weighed else _OPTIMAL),
            _FILTERS[kind],
            *(_CAREFUL if fit.careful else _PLAIN),
            *(_ABREAST if abreast else _AFTER),
        )
        text = _HEAD.format(name=model.name) + fit.text + _decorate(generated) + _join(texts)
        small = len(model.states) <= SMALL
        if abreast:
            for one, several in _LANES.items():
                text = text.replace(one, several)
        elif not small:
            text = text.replace(*_HELD)
        embed = small or not abreast  # long rows of lanes take the compiler twice the time then, for nothing
        _store(path, write_out(text, embed=embed))
    return _load(path)


def _decorate(generated: str) -> str:
    return generated.replace("\ndef ", "\n@inline\ndef ")


def _join(texts: Sequence[str]) -> str:
    """The compiled texts as one, without what they import from each other."""
    lines: list[str] = []
    for name in texts:
        text = (_HERE / f"{name}.py").read_text()
        own = [node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom) and node.module in _OWN]
        left_out = {line for node in own for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
        lines += [line for number, line in enumerate(text.splitlines(), 1) if number not in left_out]
    return "\n".join(lines) + "\n"


def _key(declared: Declaration, *measured: str) -> str:
    digest = hashlib.sha256(_common())
    for text in (declared.text, declared.function, *map(repr, declared.sensors), *measured):
        digest.update(text.encode() + b"\0")
    return f"{declared.function}-{digest.hexdigest()[:20]}"


@cache
def _common() -> bytes:
    """A digest of what all kernels of this process are made of: the texts, and who compiles them."""
    texts = [path.read_text() for folder in _SOURCES for path in sorted(folder.glob("*.py"))]
    versions = [importlib.metadata.version(package) for package in ("numba", "llvmlite", "numpy")]
    made_of = (text.encode() + b"\0" for text in (*texts, *versions, platform.python_version()))
    return hashlib.sha256(b"".join(made_of)).digest()


def _store(path: Path, text: str) -> None:
    """Write whole or not at all, so that processes that start together do not read each other's half."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(text)
        Path(file.name).replace(path)
    except OSError as error:
        raise CacheError(path.parent, error) from error


def _load(path: Path) -> ModuleType:
    name = f"fuselog_kernel_{path.parent.name.replace('-', '_')}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


class CacheError(FuselogError):
    """The folder for compiled kernels cannot be written."""

    def __init__(self, folder: Path, error: OSError) -> None:
        super().__init__(f"{folder}: cannot keep compiled kernels here ({error.strerror}); set FUSELOG_CACHE_DIR")
