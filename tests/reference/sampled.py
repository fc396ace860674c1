"""Decodes the golden blocks of sampled channels (codec/tests/golden) with the reference decoder, and compares the digest
of the decoded bits.

    python tests/reference/sampled.py

The exit code is 1 if they differ.
"""

import sys
from pathlib import Path

from take.sampled import SampledDecoder

GOLDEN = Path(__file__).parents[2] / "codec" / "tests" / "golden"


def main():
    data = (GOLDEN / "sampled.blocks").read_bytes()
    decoder, at, digest = SampledDecoder(), 0, 0xCBF29CE484222325
    while at < len(data):
        n_rows, n = int.from_bytes(data[at : at + 2], "little"), int.from_bytes(data[at + 2 : at + 6], "little")
        channels = decoder.decode(data[at + 6 : at + 6 + n], n_rows, key=at == 0)
        at += 6 + n
        # FNV-1a.
        for byte in (byte for channel in channels for bits in channel for byte in bits.to_bytes(4, "little")):
            digest = (digest ^ byte) * 0x100000001B3 & (1 << 64) - 1
    expected = (GOLDEN / "sampled.digest").read_text().strip()
    print(f"decoded {digest:016x}, expected {expected}")
    return f"{digest:016x}" != expected


if __name__ == "__main__":
    sys.exit(main())
