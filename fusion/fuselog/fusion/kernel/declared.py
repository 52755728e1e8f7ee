"""Where a model is declared: in fuselog, in a user's Python file, or in an installed package's entry point."""

import importlib
import importlib.metadata
import importlib.util
import linecache
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from fuselog.fusion.kernel.sensor_states import SensorStates
from fuselog.schemas.errors import FuselogError

if TYPE_CHECKING:
    from fuselog.fusion.models.model import Model  # SymPy takes seconds; only on a cache miss

MODEL_NAMES = (
    "brownian",
    "constant_velocity_1d",
    "constant_velocity",
    "constant_velocity_3d",
    "constant_acceleration_1d",
    "constant_acceleration",
    "constant_acceleration_3d",
    "unicycle",
    "differential_drive",
    "wall_follower",
    "omni3d",
    "attitude",
    "ins3d",
)
LINEAR = "linear"  # the name of a model by matrices
ENTRY_POINTS = "fuselog.models"
_OWN = "fuselog.fusion.models"


class ModelError(FuselogError):
    """A model that cannot be found, or is not one; says where."""


class Declaration(Protocol):
    """What makes a ``Model``, and what its kernels depend on besides fuselog itself."""

    @property
    def function(self) -> str:
        """Its name."""
        ...

    @property
    def text(self) -> str:
        """Changes when the model does."""
        ...

    @property
    def sensors(self) -> tuple[SensorStates, ...]:
        """The states that sensors add to it."""
        ...

    def declare(self) -> "Model":
        """The model."""
        ...


@dataclass(frozen=True, slots=True)
class Declared:
    """A function without arguments that returns a ``Model``, and the states that sensors add to it."""

    function: str
    module: str | None  # that has it, or None for a file
    file: Path | None  # where its text is; None for fuselog's own
    sensors: tuple[SensorStates, ...] = ()

    def with_sensors(self, sensors: tuple[SensorStates, ...]) -> "Declared":
        """The same model with the states of these sensors."""
        return replace(self, sensors=sensors)

    @property
    def text(self) -> str:
        """What its kernels depend on besides fuselog itself and the sensors' states."""
        return "" if self.file is None else self.file.read_text()

    def declare(self) -> "Model":
        """Call the function; raises ``ModelError`` that points at the line of what is wrong."""
        from fuselog.fusion.models.model import Model, NotAModelError  # noqa: PLC0415  SymPy takes seconds

        try:
            function = cast(Callable[[], Any], getattr(self._module(), self.function, None))
            if not callable(function):
                raise ModelError(f"{self.file or self.module}: has no function {self.function}")
            model = function()
        except (ModelError, NotAModelError) as error:
            if self.file is None or isinstance(error, ModelError):
                raise
            raise ModelError(f"{self._line(error, error.field, error.name)}: {error}") from error
        except Exception as error:
            if self.file is None:
                raise
            raise ModelError(f"{self._line(error)}: {type(error).__name__}: {error}") from error
        if not isinstance(model, Model):
            raise ModelError(f"{self.file}: {self.function} returns {type(model).__name__}, not a Model")
        return self._with_states(model) if self.sensors else model

    def _with_states(self, model: "Model") -> "Model":
        from fuselog.fusion.models.sensor_states import with_sensor_states  # noqa: PLC0415  SymPy takes seconds

        return with_sensor_states(model, self.sensors)

    def _module(self) -> Any:
        if self.module is not None:
            return importlib.import_module(self.module)
        assert self.file is not None
        spec = importlib.util.spec_from_file_location(f"fuselog_model_{self.file.stem}", self.file)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        linecache.checkcache(str(self.file))
        spec.loader.exec_module(module)
        return module

    def _line(self, error: BaseException, field: str = "", name: str = "") -> str:
        """``file:line`` where the file's own code was last; with a name, where that stands in the field."""
        if isinstance(error, SyntaxError):
            return f"{self.file}:{error.lineno}"
        own = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(self.file)]
        line = own[-1].lineno or 1 if own else 1
        rest = list(enumerate(self.text.splitlines(), start=1))[line - 1 :] if name else []
        begin = next((number for number, text in rest if f"{field}=" in text), line)
        quoted = (f'"{name}"', f"'{name}'")
        found = (number for number, text in rest if number >= begin and any(quote in text for quote in quoted))
        return f"{self.file}:{next(found, line)}"


def find_model(name: str, folder: Path = Path()) -> Declared:
    """The model called ``name``: fuselog's own, an entry point, or ``file.py:Function`` beside ``folder``.

    Raises ``ModelError`` for a file that is not there; ``KeyError`` for a name that nobody knows.
    """
    path, separator, function = name.rpartition(":")
    if separator and path.endswith(".py"):
        file = (folder / path).resolve()
        if not file.is_file():
            raise ModelError(f"{file}: no such file")
        return Declared(function, None, file)
    if name in MODEL_NAMES:
        return Declared(name, _OWN, None)
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS, name=name):
        spec = importlib.util.find_spec(entry.module)
        if spec is None or spec.origin is None:
            raise ModelError(f"entry point {name}: no module {entry.module}")
        return Declared(entry.attr, entry.module, Path(spec.origin))
    raise KeyError(name)


def known_models() -> list[str]:
    """All names but those of files."""
    return [*MODEL_NAMES, LINEAR, *(entry.name for entry in importlib.metadata.entry_points(group=ENTRY_POINTS))]
