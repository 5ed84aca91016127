"""Damage to the bytes of a file that respects its structure: inside compressed data, and under valid checksums."""

import gzip
import random
import re
import zlib

from tests.scenes.samples import zip_bytes

NUMBERS = [
    "-1",
    "0",
    "1",
    "1e400",
    "-1e400",
    "nan",
    "inf",
    "1e-310",
    "9" * 30,
    "4294967296",
    "0.5",
    "''",
    "null",
    "[]",
    "{}",
]


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Overwrite, insert, delete, repeat or truncate bytes, more often near the start, and replace numbers in text."""
    result = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = int(rng.random() ** rng.choice((1, 4)) * len(result))
        size = rng.choice((1, 1, 2, 4, 8, 64))
        kind = rng.randrange(7)
        if kind == 0:
            result[at : at + size] = rng.randbytes(size)
        elif kind == 1:
            result[at:at] = rng.randbytes(size)
        elif kind == 2:
            del result[at : at + size]
        elif kind == 3:
            result[at : at + size] = rng.choice((b"\x00", b"\xff", b"\x7f", b"\x80")) * size
        elif kind == 4:
            result[at:at] = result[at : at + 16 * size]
        elif kind == 5 and rng.random() < 0.3:
            del result[at:]
        else:
            numbers = list(re.finditer(rb"-?[0-9]+\.?[0-9]*", bytes(result[: 1 << 16])))
            if numbers:
                found = rng.choice(numbers)
                result[found.start() : found.end()] = rng.choice(NUMBERS).encode()
    return bytes(result)


def behind_gzip(content: bytes, rng: random.Random) -> bytes:
    """Damage the compressed content, or in 30 % of cases the compressed bytes themselves."""
    return gzip.compress(damaged(gzip.decompress(content), rng), 1) if rng.random() < 0.7 else damaged(content, rng)


def behind_zip(entries: dict[str, bytes], rng: random.Random) -> bytes:
    """Damage an entry of an archive, or in 20 % of cases the archive itself."""
    if rng.random() < 0.2:
        return damaged(zip_bytes(entries), rng)
    name = rng.choice(sorted(entries))
    return zip_bytes({**entries, name: damaged(entries[name], rng)})


def behind_checksums(png: bytes, rng: random.Random) -> bytes:
    """Damage the chunks of a PNG, and give each chunk a valid checksum."""
    result, at = png[:8], 8
    while at + 12 <= len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        chunk = png[at + 4 : at + 8 + size]
        if rng.random() < 0.5:
            chunk = chunk[:4] + damaged(chunk[4:], rng)
        length = len(chunk) - 4 if rng.random() < 0.9 else rng.randrange(1 << 32)
        result += length.to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        at += 12 + size
    return result
