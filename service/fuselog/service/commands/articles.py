"""``fuselog articles``: the five articles that fuselog follows, run and compared."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuselog.service.console import print_json, progress

if TYPE_CHECKING:
    from fuselog.replay.articles import Figure, Reproduction

_DIFFERS = 4


def articles(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Where to leave articles.html.")] = Path(
        "fuselog-articles"
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer runs a mean, with the wider tolerances they have.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Run every system of the five articles; write one page of published figures, ours, pictures and errata.

    Exits 0 when all figures that can be reproduced agree, 4 when one differs.
    """
    with progress("the first run compiles, which takes minutes") as step:
        from fuselog.replay.articles import (  # noqa: PLC0415  slow to import
            ARTICLES,
            QUICK_RUNS,
            RUNS,
            check_pictures,
            render,
            reproduce,
        )

        check_pictures()
        found = reproduce(ARTICLES, runs=QUICK_RUNS if quick else RUNS, step=step)
        page = _write(output, render(found))
    if as_json:
        print_json({**found.to_json(), "page": str(page)})
    else:
        _print(found, page)
    if not found.agrees:
        raise typer.Exit(_DIFFERS)


def _write(folder: Path, text: str) -> Path:
    from fuselog.service.errors import OutputError  # noqa: PLC0415  as the rest

    page = folder / "articles.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(page, error.strerror or str(error)) from error
    return page


def _print(found: "Reproduction", page: Path) -> None:
    wide = max(len(figure.name) for one in found.articles for figure in one.figures)
    for one in found.articles:
        typer.echo(
            f"\n{one.article.author + ': ' + one.article.title:{wide}}{'published':>11}{'theory':>11}{'ours':>11}"
        )
        for figure in one.figures:
            numbers = "".join(f"{_short(value):>11}" for value in (figure.published, figure.expected, figure.ours))
            typer.echo(f"{figure.name:{wide}}{numbers}  {_verdict(figure)}".rstrip())
        broken = [proven.erratum.id for proven in one.errata if proven.proof is not None and not proven.proof.holds]
        typer.echo(f"{len(one.errata)} errata" + (f", not proved: {', '.join(broken)}" if broken else ""))
    typer.echo(f"\nSee it:  {page}")


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _verdict(figure: "Figure") -> str:
    if not figure.reproducible:
        return "not reproducible"
    return "" if figure.agrees is None else "agrees" if figure.agrees else "DIFFERS"
