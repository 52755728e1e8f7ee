"""The fast CRC 32 is zlib's."""

import zlib

import numpy as np
import pytest

from fuselog.replay.mcap_file import crc


@pytest.mark.parametrize("carryless", [True, False])
def test_any_length_at_any_place(carryless: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not carryless:
        monkeypatch.setattr(crc, "_has_carryless_multiplication", lambda: False)
    data = np.random.default_rng(1).integers(0, 256, 1 << 17, dtype=np.uint8)
    for length in [0, 1, 63, 4095, *range(4096, 4096 + 130), 65535, 1 << 16, 100_001]:
        part = data[length % 7 :][:length]
        assert crc.crc32(part) == zlib.crc32(part), length


def test_a_flipped_bit_shows() -> None:
    data = np.zeros(10_000, np.uint8)
    before = crc.crc32(data)
    data[9_000] = 1
    assert crc.crc32(data) != before
