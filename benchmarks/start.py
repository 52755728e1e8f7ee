"""How long a first start takes, when kernels must be made, and a later one: for every model that comes with fuselog.

    python benchmarks/start.py [--models omni3d ins3d]

Each start is a process of its own: import, plan (SymPy on a first start), the kernel's first call. Two sensors: one
that gives states, and one that gives the input where the model has one. CPU time; the goals are 15 s for the kernel,
and 4 s for a later start.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile

from fuselog.fusion.kernel.declared import MODEL_NAMES

_CHILD = """
import json, sys, time
from fuselog.fusion import Engine, compile_plan, parse_config
from fuselog.fusion.events import blank_events
from fuselog.fusion.kernel.cache import model_card
from fuselog.fusion.kernel.declared import find_model
imported = time.process_time()
model = sys.argv[1]
card = model_card(find_model(model))
states = list(card.states)
sensors = {"some": {"topic": "/some", "fuse": states[:3], "noise": dict.fromkeys(states[:3], 0.1)}}
if card.inputs:
    sensors["drive"] = {"topic": "/drive", "kind": "input", "noise": dict.fromkeys(card.inputs, 0.1)}
config = {"fuselog": 1, "model": {"name": model}, "sensors": sensors}
plan = compile_plan(*parse_config(json.dumps(config)))
planned = time.process_time()
Engine(plan).advance(blank_events(0, plan.tables.M))
print(json.dumps([imported, planned - imported, time.process_time() - planned]))
"""


def start(model: str, cache: str) -> list[float]:
    """CPU seconds to import, to plan, and for the kernel's first call."""
    environment = os.environ | {"FUSELOG_CACHE_DIR": cache, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", _CHILD, model], env=environment, check=True, capture_output=True)
    return json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", nargs="*", default=list(MODEL_NAMES), choices=MODEL_NAMES)
    print(f"{'s of CPU':<28} {'import':>8} {'plan':>8} {'kernel':>8} {'all':>8}    a later start: all")
    for model in parser.parse_args().models:
        with tempfile.TemporaryDirectory() as cache:
            first, later = start(model, cache), start(model, cache)
        print(f"{model:<28} {' '.join(f'{s:>8.2f}' for s in (*first, sum(first)))}    {sum(later):>8.2f}", flush=True)


if __name__ == "__main__":
    main()
