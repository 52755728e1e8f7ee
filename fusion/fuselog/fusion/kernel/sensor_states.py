"""Which states sensors add to a model: biases, scale errors and lever arms that the filter estimates."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """One number that a sensor measures (or drives the model with), and its unit."""

    name: str
    quantity: str | None  # that it is; None for the state or the input of its name
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorStates:
    """The states of one sensor, and the numbers that depend on them."""

    sensor: str
    numbers: tuple[Number, ...]  # all that it measures
    bias: tuple[str, ...] = ()  # numbers
    scale: tuple[str, ...] = ()  # numbers
    lever: bool = False
    drives: bool = False  # the numbers are inputs

    def bias_of(self, number: str) -> str:
        """The name of the bias state of a number."""
        return f"{self.sensor}.bias.{number}"

    def scale_of(self, number: str) -> str:
        """The name of the state of a number's scale error."""
        return f"{self.sensor}.scale.{number}"

    def lever_of(self, axis: str) -> str:
        """The name of the state of the lever arm along an axis."""
        return f"{self.sensor}.lever_{axis}"

    def measured(self, number: str) -> str:
        """The name of the quantity that a number is with the sensor's states in it."""
        return f"{self.sensor}.{number}"
