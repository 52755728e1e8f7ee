"""A model with states of its sensors: what a number is off by, and where the sensor sits, estimated with the rest."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false
# pyright: reportReturnType=false, reportAssignmentType=false

from collections.abc import Mapping, Sequence
from dataclasses import replace

import sympy as sp

from fuselog.fusion.kernel.sensor_states import SensorStates
from fuselog.fusion.models.model import Body, Expr, Model, Rotation, symbol, white_noise
from fuselog.fusion.models.quantities import SENSOR, quantities

_LEVER = dict(zip("xyz", SENSOR[:3], strict=True))


def with_sensor_states(model: Model, sensors: Sequence[SensorStates]) -> Model:
    """The model with a random walk for every bias, scale error and lever arm of these sensors.

    A measuring sensor reads (1 + scale) h + bias, with its lever arm in h; what drives the model is
    (reading - bias) / (1 + scale). A lever arm has the axes on which what the sensor measures depends. States are named
    ``sensor.bias.number``, ``sensor.scale.number`` and ``sensor.lever_x``; their densities have the same names, and 0.
    """
    base = quantities(model.body)
    states: dict[str, str] = {}
    measured: dict[str, Expr] = {}
    inputs: dict[sp.Symbol, Expr] = {}
    for sensor in sensors:
        units = {number.name: number.unit for number in sensor.numbers}
        states |= {sensor.bias_of(name): units[name] for name in sensor.bias}
        states |= {sensor.scale_of(name): "1" for name in sensor.scale}
        for number in sensor.numbers:
            plain = symbol(number.name) if number.quantity is None else base[number.quantity]
            if sensor.drives:
                inputs[symbol(number.name)] = _true(sensor, number.name, plain)
                continue
            read = _read(sensor, number.name, plain)
            if read != plain:
                measured[sensor.measured(number.name)] = read
            used = {str(s) for s in read.free_symbols}
            states |= {name: "m" for axis in _LEVER if (name := sensor.lever_of(axis)) in used}
    moved = {name: sp.sympify(value).xreplace(inputs) for name, value in model.transition.items()}
    return replace(
        model,
        states={**model.states, **states},
        transition={**moved, **{name: symbol(name) for name in states}},
        rotation=None if model.rotation is None else Rotation(turn=_triple(model.rotation.turn, inputs)),
        noise={**model.noise, **dict.fromkeys(states, 0.0)},
        covariance={**model.covariance, **white_noise(*states)},
        body=None if model.body is None else _body(model.body, inputs),
        measured={**model.measured, **{name: read.xreplace(inputs) for name, read in measured.items()}},
    )


def _read(sensor: SensorStates, number: str, h: Expr) -> Expr:
    """(1 + scale) h + bias."""
    if sensor.lever:
        h = h.xreplace({lever: symbol(sensor.lever_of(axis)) for axis, lever in _LEVER.items()})
    if number in sensor.scale:
        h = (1 + symbol(sensor.scale_of(number))) * h
    return h + symbol(sensor.bias_of(number)) if number in sensor.bias else h


def _true(sensor: SensorStates, number: str, read: Expr) -> Expr:
    """What a reading says: (reading - bias) / (1 + scale)."""
    true = read - symbol(sensor.bias_of(number)) if number in sensor.bias else read
    return true / (1 + symbol(sensor.scale_of(number))) if number in sensor.scale else true


def _body(body: Body, inputs: Mapping[sp.Symbol, Expr]) -> Body:
    return Body(
        position=_triple(body.position, inputs),
        velocity=_triple(body.velocity, inputs),
        world_from_body=body.world_from_body.xreplace(inputs),
        twist_linear=_triple(body.twist_linear, inputs),
        twist_angular=_triple(body.twist_angular, inputs),
        acceleration=None if body.acceleration is None else _triple(body.acceleration, inputs),
    )


def _triple(vector: Sequence[Expr], inputs: Mapping[sp.Symbol, Expr]) -> tuple[Expr, Expr, Expr]:
    x, y, z = (sp.sympify(part).xreplace(inputs) for part in vector)
    return x, y, z
