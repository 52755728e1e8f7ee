"""The five articles, run."""

from collections.abc import Callable, Sequence

from fuselog.replay.articles import (
    alymov,
    belous,
    bezmen,
    kiselev_control,
    kiselev_errata,
    kiselev_particle,
    kiselev_wall,
    melnikov,
)
from fuselog.replay.articles.result import Article, Experiment, Proven, Reproduced, Reproduction

RUNS, QUICK_RUNS = 1000, 200  # of a mean; the articles' own means are over 1000

ARTICLES: Sequence[Article] = (
    Article(
        key="kiselev",
        author="Kiselev 2020",
        title="an elementary introduction to Kalman filtering",
        experiments=(
            kiselev_particle.figure_4,
            kiselev_particle.figure_5,
            kiselev_particle.figure_6,
            kiselev_wall.figure_8,
            kiselev_wall.figure_9,
            kiselev_control.figure_10,
        ),
        errata=(*kiselev_particle.ERRATA, *kiselev_errata.ERRATA),
    ),
    Article(
        key="belous",
        author="Belous, Belov 2019",
        title="Kalman filters, linear and extended, for motion capture",
        experiments=(belous.linear_system, belous.nonlinear_system),
        errata=belous.ERRATA,
    ),
    Article(
        key="alymov",
        author="Alymov 2023",
        title="Kalman filters in one and two dimensions",
        experiments=(alymov.one_d, alymov.two_d),
        errata=alymov.ERRATA,
    ),
    Article(
        key="bezmen",
        author="Bezmen 2019",
        title="data fusion with an extended Kalman filter or fixed weights",
        experiments=(bezmen.weights, bezmen.missing),
        errata=bezmen.ERRATA,
    ),
    Article(
        key="melnikov",
        author="Melnikov",
        title="Kalman's gain for a falling stone",
        experiments=(melnikov.stone,),
        errata=melnikov.ERRATA,
    ),
)

Step = Callable[[float, float], None]


def reproduce(articles: Sequence[Article], *, runs: int, step: Step) -> Reproduction:
    """Run the articles, with this many runs a mean; ``step`` hears how many experiments and proofs are done."""
    total = sum(len(article.experiments) + len(article.errata) for article in articles)
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        step(done, total)

    found: list[Reproduced] = []
    for article in articles:
        experiments: list[Experiment] = []
        for experiment in article.experiments:
            experiments.append(experiment(runs))
            tick()
        proven: list[Proven] = []
        for erratum in article.errata:
            proven.append(Proven(erratum=erratum, proof=None if erratum.prove is None else erratum.prove()))
            tick()
        found.append(Reproduced(article=article, experiments=experiments, errata=proven))
    return Reproduction(runs=runs, articles=found)
