"""The articles that fuselog follows, run: their figures beside ours, and their slips with the proof of each."""

from fuselog.replay.articles.draw import PicturesError, check_pictures
from fuselog.replay.articles.page import render
from fuselog.replay.articles.reproduce import ARTICLES, QUICK_RUNS, RUNS, reproduce
from fuselog.replay.articles.result import Article, Erratum, Experiment, Figure, Proof, Reproduction

__all__ = [
    "ARTICLES",
    "QUICK_RUNS",
    "RUNS",
    "Article",
    "Erratum",
    "Experiment",
    "Figure",
    "PicturesError",
    "Proof",
    "Reproduction",
    "check_pictures",
    "render",
    "reproduce",
]
