"""``fuselog warm-up``: kernels compiled ahead, so that nothing is compiled at run time."""

from pathlib import Path
from typing import Annotated

import typer

from fuselog.service.console import stderr


def warm_up(
    config: Annotated[list[Path], typer.Argument(help="Fusion configurations (YAML).")],
) -> None:
    """Compile all that these configurations need, into the cache that later runs use (FUSELOG_CACHE_DIR)."""
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.service.live.warm import warm_up as compile_all  # noqa: PLC0415  slow to import

    for path in config:
        compile_all(load_plan(path))
        stderr.print(f"compiled: {path}")
