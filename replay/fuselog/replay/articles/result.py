"""What an article claims and what came out: figures, errata with their proofs, pictures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_SIGMAS = 3  # that two numbers may differ by, in standard deviations of their difference


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One number. ``printed`` is as the article has it, ``expected`` what theory says; either may be absent.

    ``sigma`` is the standard deviation of ``ours``, 0 for a number without chance in it, ``printed_sigma`` that of the
    article's own. A printed number is also uncertain by half a unit of its last digit. ``slack`` is how much the theory
    may be off, such as by a linearisation.
    """

    name: str
    ours: float
    unit: str = ""
    printed: str = ""
    printed_sigma: float = 0.0
    expected: float | None = None
    slack: float = 0.0
    sigma: float = 0.0
    runs: int = 1
    reproducible: bool = True
    note: str = ""

    @property
    def published(self) -> float | None:
        """What the article prints, as a number."""
        return float(self.printed) if self.printed else None

    @property
    def tolerance(self) -> float:
        """How far ``ours`` may be from the published number, or from the expected one where none is."""
        if self.printed:
            exponent = Decimal(self.printed).as_tuple().exponent
            rounding = 0.5 * 10.0 ** int(exponent)
            return _SIGMAS * math.hypot(self.sigma, self.printed_sigma) + rounding
        return _SIGMAS * self.sigma + self.slack

    @property
    def agrees(self) -> bool | None:
        """Whether ours is what was published, and what theory expects; None where there is nothing to compare."""
        if not self.reproducible or (self.published is None and self.expected is None):
            return None
        as_published = self.published is None or abs(self.ours - self.published) <= self.tolerance
        within = _SIGMAS * self.sigma + self.slack
        return as_published and (self.expected is None or abs(self.ours - self.expected) <= within)

    def to_json(self) -> dict[str, Any]:
        """The figure as plain data."""
        return {
            "name": self.name,
            "unit": self.unit,
            "published": self.published,
            "expected": self.expected,
            "ours": self.ours,
            "sigma": self.sigma,
            "tolerance": self.tolerance,
            "runs": self.runs,
            "reproducible": self.reproducible,
            "agrees": self.agrees,
            "note": self.note,
        }


def mean_figure(name: str, values: Floats, *, printed_runs: int = 0, **rest: Any) -> Figure:
    """The mean of one value a run (runs,); the article's is the mean of ``printed_runs`` such values."""
    sd, runs = float(np.std(values, ddof=1)), len(values)
    printed_sigma = sd / math.sqrt(printed_runs) if printed_runs else 0.0
    sigma = sd / math.sqrt(runs)
    return Figure(name=name, ours=float(np.mean(values)), sigma=sigma, printed_sigma=printed_sigma, runs=runs, **rest)


def rms_figure(name: str, errors: Floats, **rest: Any) -> Figure:
    """The root mean square of errors (runs, n)."""
    squares: Floats = np.mean(errors**2, axis=1)
    ours = float(np.sqrt(np.mean(squares)))
    sigma = float(np.std(squares, ddof=1)) / math.sqrt(len(squares)) / (2 * ours)
    return Figure(name=name, ours=ours, sigma=sigma, runs=len(squares), **rest)


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A named series (n,) in a chart; ``role`` decides how it is drawn."""

    label: str
    x: Floats
    y: Floats
    role: str  # truth, measured, fused, other, wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One pair of axes."""

    x: str
    y: str
    lines: Sequence[Line]
    plan: bool = False  # a map: both axes in one scale


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """Panels side by side, and what they show in words."""

    name: str
    panels: Sequence[Panel]


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """One system of an article, run: what was done, its figures and pictures."""

    title: str
    text: str
    figures: Sequence[Figure]
    pictures: Sequence[Picture] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """Numbers that show an erratum, and whether they do."""

    numbers: Mapping[str, float]
    holds: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Erratum:
    """A slip of an article: what is printed, what is right. ``prove`` is None where it is one of wording only."""

    id: str
    where: str
    printed: str
    correct: str
    prove: Callable[[], Proof] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Article:
    """What is run of an article: ``experiments`` take the number of runs of a mean."""

    key: str
    author: str
    title: str
    experiments: Sequence[Callable[[int], Experiment]]
    errata: Sequence[Erratum]


@dataclass(frozen=True, slots=True, kw_only=True)
class Proven:
    """An erratum with its proof."""

    erratum: Erratum
    proof: Proof | None

    def to_json(self) -> dict[str, Any]:
        """The erratum as plain data."""
        proof = self.proof
        return {
            "id": self.erratum.id,
            "where": self.erratum.where,
            "printed": self.erratum.printed,
            "correct": self.erratum.correct,
            "numbers": None if proof is None else dict(proof.numbers),
            "holds": None if proof is None else proof.holds,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduced:
    """An article that was run."""

    article: Article
    experiments: Sequence[Experiment]
    errata: Sequence[Proven] = field(default_factory=tuple[Proven, ...])

    @property
    def figures(self) -> list[Figure]:
        """All figures, in order."""
        return [figure for experiment in self.experiments for figure in experiment.figures]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """All articles that were run, with ``runs`` runs a mean."""

    runs: int
    articles: Sequence[Reproduced]

    @property
    def agrees(self) -> bool:
        """Whether every figure that can be reproduced was, and every erratum proved."""
        figures = all(figure.agrees is not False for one in self.articles for figure in one.figures)
        proofs = [proven.proof for one in self.articles for proven in one.errata]
        return figures and all(proof is None or proof.holds for proof in proofs)

    def to_json(self) -> dict[str, Any]:
        """The result as plain data."""
        return {
            "schema": 1,
            "runs": self.runs,
            "agrees": self.agrees,
            "figures": [
                {"article": one.article.key, **figure.to_json()} for one in self.articles for figure in one.figures
            ],
            "errata": [
                {"article": one.article.key, **proven.to_json()} for one in self.articles for proven in one.errata
            ],
        }
