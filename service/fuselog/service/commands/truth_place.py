"""How the command line says where the truth is."""

from pathlib import Path

import typer


def truth_place(text: str) -> tuple[Path, str]:
    """The log and the topic of ``LOG:TOPIC``; an error of usage for anything else."""
    path, _, topic = text.rpartition(":")
    if not path or not topic:
        raise typer.BadParameter("expected LOG:TOPIC, such as drive.mcap:/ground_truth", param_hint="--truth")
    return Path(path), topic


def truth_fields(given: list[str]) -> dict[str, str]:
    """STATE=PATH, one a text; an error of usage for anything else."""
    pairs = [text.partition("=") for text in given]
    bad = [state for state, _, path in pairs if not state or not path]
    if bad:
        raise typer.BadParameter(f"expected STATE=PATH, got {bad[0]!r}", param_hint="--field")
    return {state: path for state, _, path in pairs}
