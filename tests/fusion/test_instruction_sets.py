"""The same input gives the same bytes whatever vector instructions a processor has: nothing is contracted."""

import hashlib
import os
import platform
import subprocess
import sys

import pytest

TARGETS = {"SSE2": "x86-64", "AVX2": "haswell", "AVX-512": "skylake-avx512"}
RUN = """
import hashlib
import numpy as np
from tests.fusion.setups import Sample, events_of, setup, truth
from fuselog.fusion import Engine

plan, rng, samples = setup("unicycle", sensors={"gps": {"gate": 0.9}}), np.random.default_rng(8), []
for k in range(3000):
    t_ns = 1_000_000_000 + k * 10_000_000
    x = truth("unicycle", t_ns * 1e-9)
    samples.append(Sample(t_ns, "wheel", x[3:5] + rng.normal(0, 0.05, 2), 0.0025))
    if k % 7 == 0:
        away = x[:2] + rng.normal(0, 0.3, 2) + [60.0, -45.0]
        samples.append(Sample(t_ns, "radar", [np.hypot(*away), np.arctan2(away[1], away[0]), 0.1], 0.04))
    if k % 10 == 0:
        samples.append(Sample(t_ns, "gps", x[:2] + rng.normal(0, 0.3, 2), 0.09))
track = Engine(plan).advance(events_of(plan, samples))
digest = hashlib.sha256()
for column in (track.x, track.P, track.nis, track.decision, track.innovation, track.absorbed):
    digest.update(np.ascontiguousarray(column).tobytes())
print(digest.hexdigest())
"""


def supported(target: str) -> bool:
    with open("/proc/cpuinfo", encoding="ascii") as text:
        flags = text.read()
    return {"SSE2": " sse2 ", "AVX2": " avx2 ", "AVX-512": " avx512f "}[target] in flags


@pytest.mark.skipif(
    platform.machine() != "x86_64" or sys.platform != "linux", reason="asks a Linux x86 processor what it has"
)
def test_every_instruction_set_gives_the_same_bytes(tmp_path) -> None:
    digests = {}
    for target, cpu in TARGETS.items():
        if not supported(target):
            continue
        environment = os.environ | {
            "NUMBA_CPU_NAME": cpu,
            "NUMBA_CPU_FEATURES": "",
            "FUSELOG_CACHE_DIR": str(tmp_path / cpu),
            "NUMBA_CACHE_DIR": str(tmp_path / f"{cpu}-numba"),
        }
        run = subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        digests[target] = run.stdout.strip()
    assert len(digests) > 1, "this processor has one instruction set only"
    assert len(set(digests.values())) == 1, digests
    assert all(len(digest) == hashlib.sha256().digest_size * 2 for digest in digests.values())
