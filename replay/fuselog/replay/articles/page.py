"""One page of everything: figures beside those of the articles, pictures, errata with their proofs."""

import re
from html import escape

from fuselog.replay.articles.draw import draw
from fuselog.replay.articles.result import Experiment, Figure, Proof, Proven, Reproduced, Reproduction

_DIGITS = 8  # of a printed number that are shown as they are
_STYLE = """
:root { color-scheme: light dark; --ink: #1d2330; --soft: #5c6675; --line: #d9dee6; --page: #ffffff; --card: #f5f7fa;
  --good: #1a7f4b; --bad: #c22f3d; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ef; --soft: #9aa5b5; --line: #39414f; --page: #161a21;
  --card: #1e242d; --good: #4cc38a; --bad: #ff7b85; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 2rem 1.25rem 4rem; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; } h2 { font-size: 1.35rem; margin: 3rem 0 .2rem; padding-top: 1rem;
  border-top: 1px solid var(--line); } h3 { font-size: 1.05rem; margin: 2rem 0 .3rem; }
p { margin: .3rem 0 .8rem; max-width: 52rem; } .soft { color: var(--soft); }
nav a { margin-right: 1.2rem; } a { color: inherit; }
.wide { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: .9rem; }
th, td { text-align: left; padding: .3rem .7rem .3rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; color: var(--soft); white-space: nowrap; } td.n, th.n { text-align: right;
  font-variant-numeric: tabular-nums; white-space: nowrap; }
.good { color: var(--good); } .bad { color: var(--bad); font-weight: 700; }
sub, sup { font-size: .75em; line-height: 0; }
.note { display: block; color: var(--soft); font-size: .85em; max-width: 34rem; }
figure { margin: .8rem 0 1rem; } figure svg { width: 100%; height: auto; display: block; }
figure svg text { font-family: system-ui, "Segoe UI", "DejaVu Sans", sans-serif !important; }
.errata { display: grid; gap: .8rem; } .erratum { background: var(--card); border-radius: .5rem; padding: .7rem 1rem; }
.erratum p { margin: .15rem 0; max-width: none; } .erratum b { margin-right: .5rem; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(19rem, 1fr)); gap: 0 1.5rem; margin: .5rem 0 0;
  font-size: .88rem; } dl div { display: flex; justify-content: space-between; gap: 1rem;
  border-top: 1px dotted var(--line); padding: .12rem 0; } dt { color: var(--soft); } dd { margin: 0;
  font-variant-numeric: tabular-nums; white-space: nowrap; }
"""


def render(found: Reproduction) -> str:
    """The page as HTML that needs nothing else; the same result gives the same bytes."""
    links = "".join(f'<a href="#{one.article.key}">{escape(one.article.author)}</a>' for one in found.articles)
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>Five articles, run by fuselog</title>\n<style>{_STYLE}</style>\n</head>\n<body>",
            "<h1>Five articles, run by fuselog</h1>",
            f"<p>{_summary(found)}</p>",
            f'<p class="soft">{_HOW}</p>',
            f"<nav>{links}</nav>",
            *(_article(one) for one in found.articles),
            "</body>\n</html>\n",
        ]
    )


_HOW = (
    "Every system is simulated with its truth, written as messages, and fused by the filter that also runs live. "
    "<b>Published</b> is what the article prints; <b>theory</b> is computed from covariances without any noise; "
    "<b>fuselog</b> is what came out, ± one standard deviation of that mean. A figure agrees when it is within three "
    "standard deviations of both, the chance and the rounding in the article's own number included."
)


def _summary(found: Reproduction) -> str:
    figures = [figure for one in found.articles for figure in one.figures]
    published = [figure for figure in figures if figure.published is not None]
    agree = sum(figure.agrees is True for figure in published)
    lost = sum(not figure.reproducible for figure in published)
    differ = sum(figure.agrees is False for figure in figures)
    proofs = [proven.proof for one in found.articles for proven in one.errata if proven.proof is not None]
    held = sum(proof.holds for proof in proofs)
    verdict = '<b class="good">All agree.</b>' if found.agrees else f'<b class="bad">{differ} differ.</b>'
    theory = sum(figure.agrees is True for figure in figures if figure.expected is not None)
    of_theory = sum(figure.expected is not None for figure in figures)
    return (
        f"{verdict} {agree} of {len(published)} published figures are reproduced, {lost} cannot be; {theory} of "
        f"{of_theory} figures are as theory has them; {held} of {len(proofs)} errata are proved by numbers. "
        f"Means are over {found.runs} runs unless another number is given."
    )


def _article(one: Reproduced) -> str:
    errata = "\n".join(_erratum(proven) for proven in one.errata)
    return "\n".join(
        [
            f'<section id="{one.article.key}">\n<h2>{escape(one.article.author)}</h2>',
            f'<p class="soft">{escape(one.article.title)}</p>',
            *(_experiment(experiment) for experiment in one.experiments),
            f'<h3>Errata</h3>\n<div class="errata">\n{errata}\n</div>\n</section>',
        ]
    )


def _experiment(experiment: Experiment) -> str:
    pictures = "\n".join(f"<figure>{draw(picture)}</figure>" for picture in experiment.pictures)
    rows = "\n".join(_row(figure) for figure in experiment.figures)
    head = (
        '<tr><th>figure</th><th class="n">published</th><th class="n">theory</th><th class="n">fuselog</th>'
        '<th class="n">±</th><th>unit</th><th class="n">runs</th><th></th></tr>'
    )
    return (
        f"<h3>{_text(experiment.title)}</h3>\n<p>{_text(experiment.text)}</p>\n{pictures}\n"
        f'<div class="wide"><table>\n{head}\n{rows}\n</table></div>'
    )


def _row(figure: Figure) -> str:
    note = f'<span class="note">{_text(figure.note)}</span>' if figure.note else ""
    published = "" if figure.published is None else _published(figure)
    expected = "" if figure.expected is None else _number(figure.expected)
    sigma = _number(figure.sigma, 2) if figure.sigma else ""
    runs = str(figure.runs) if figure.runs > 1 else ""
    cells = "".join(f'<td class="n">{text}</td>' for text in (published, expected, _number(figure.ours), sigma))
    return (
        f"<tr><td>{_text(figure.name)}{note}</td>{cells}<td>{escape(figure.unit)}</td>"
        f'<td class="n">{runs}</td><td>{_verdict(figure)}</td></tr>'
    )


def _published(figure: Figure) -> str:
    """As it is printed, but for digits that nobody reads."""
    return figure.printed if len(figure.printed) <= _DIGITS else f"{float(figure.printed):.4g}"


def _verdict(figure: Figure) -> str:
    if not figure.reproducible:
        return '<span class="soft">not reproducible</span>'
    if figure.agrees is None:
        return ""
    return '<span class="good">agrees</span>' if figure.agrees else '<span class="bad">differs</span>'


def _erratum(proven: Proven) -> str:
    erratum = proven.erratum
    return (
        f'<div class="erratum"><p><b>{erratum.id}</b>{_text(erratum.where)}{_held(proven.proof)}</p>'
        f'<p><span class="soft">printed:</span> {_text(erratum.printed)}</p>'
        f'<p><span class="soft">right:</span> {_text(erratum.correct)}</p>{_numbers(proven.proof)}</div>'
    )


def _held(proof: Proof | None) -> str:
    if proof is None:
        return ' <span class="soft">(wording)</span>'
    return "" if proof.holds else ' <span class="bad">not proved</span>'


def _numbers(proof: Proof | None) -> str:
    if proof is None:
        return ""
    rows = "".join(
        f"<div><dt>{_text(name)}</dt><dd>{_number(value)}</dd></div>" for name, value in proof.numbers.items()
    )
    return f"<dl>{rows}</dl>"


def _text(plain: str) -> str:
    """Words and formulas with their subscripts: σξ, ωR, k_y."""
    return re.sub(r"(?<=σ)([ξηζθ])|(?<=ω)([RL])|(?<=δ)([EN])|_([A-Za-zα-ω]+)", _lower, escape(plain))


def _lower(found: re.Match[str]) -> str:
    return f"<sub>{next(filter(None, found.groups()))}</sub>"


def _number(value: float, digits: int = 4) -> str:
    """Such as 0.01625 or −2.5·10⁻⁵."""
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    times = f"·10<sup>{int(exponent)}</sup>" if exponent else ""
    return (mantissa + times).replace("-", "−")
