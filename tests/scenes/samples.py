"""Gaussians and splat files made by hand, from the formats' descriptions rather than with the code that reads them."""

import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from splatrl.scenes.gaussians import Gaussians

PLY_TYPES = {"ascii": "<f4", "binary_little_endian": "<f4", "binary_big_endian": ">f4"}


def sample_gaussians(count: int = 7, degree: int = 2, seed: int = 0) -> Gaussians:
    """Return visible Gaussians of ordinary sizes."""
    generator = torch.Generator().manual_seed(seed)
    normal = torch.randn(count, 16 * 3 + 10, generator=generator)
    return Gaussians(
        means=3 * normal[:, :3],
        quats=torch.nn.functional.normalize(normal[:, 3:7], dim=1),
        scales=(normal[:, 7:10] - 3).exp(),
        opacities=torch.rand(count, generator=generator) * 0.9 + 0.05,
        sh=0.5 * normal[:, 10:].reshape(count, 16, 3)[:, : (degree + 1) ** 2],
        batch_size=[count],
    )


def assert_same(read: Gaussians, expected: Gaussians, atol: float = 2e-6) -> None:
    """Check that fields are equal, quaternions up to their sign."""
    for name in ("means", "scales", "opacities", "sh"):
        torch.testing.assert_close(getattr(read, name), getattr(expected, name), atol=atol, rtol=2e-6, msg=name)
    torch.testing.assert_close((read.quats * expected.quats).sum(1).abs(), torch.ones(len(expected)))


def assert_valid(gaussians: Gaussians) -> None:
    """Check everything that the fields of ``Gaussians`` promise."""
    count = len(gaussians)
    assert count > 0
    assert gaussians.means.shape == gaussians.scales.shape == (count, 3)
    assert gaussians.sh.shape == (count, (gaussians.sh_degree + 1) ** 2, 3)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert getattr(gaussians, name).dtype == torch.float32
        assert getattr(gaussians, name).isfinite().all(), name
    assert (gaussians.scales > 0).all()
    assert (gaussians.opacities >= (1 - 1e-6) / 255).all() and (gaussians.opacities <= 1).all()
    torch.testing.assert_close(gaussians.quats.norm(dim=1), torch.ones(count))


def ply_fields(gaussians: Gaussians) -> dict[str, NDArray[np.float32]]:
    """Return the fields of a 3DGS PLY file by name, in Inria's order but without normals."""
    sh = gaussians.sh.numpy()
    fields = {name: gaussians.means[:, i].numpy() for i, name in enumerate("xyz")}
    fields |= {f"f_dc_{c}": sh[:, 0, c] for c in range(3)}
    higher = sh.shape[1] - 1
    fields |= {f"f_rest_{c * higher + k}": sh[:, 1 + k, c] for c in range(3) for k in range(higher)}
    fields["opacity"] = (gaussians.opacities / (1 - gaussians.opacities)).log().numpy()
    fields |= {f"scale_{i}": gaussians.scales[:, i].log().numpy() for i in range(3)}
    fields |= {f"rot_{i}": 2.5 * gaussians.quats[:, i].numpy() for i in range(4)}  # trainers do not normalise
    return fields


def ply_bytes(
    fields: Mapping[str, NDArray[np.float32]], kind: str = "binary_little_endian", count: int | None = None
) -> bytes:
    """Return a PLY file of float fields; ``count`` replaces the true number of rows in the header."""
    columns = np.stack([np.asarray(values, np.float64) for values in fields.values()], 1)
    header = ["ply", f"format {kind} 1.0", "comment by hand", f"element vertex {count or len(columns)}"]
    header += [*(f"property float {name}" for name in fields), "end_header", ""]
    if kind == "ascii":
        body = "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in columns).encode()
    else:
        body = columns.astype(PLY_TYPES[kind]).tobytes()
    return "\n".join(header).encode() + body


def spz_payload(
    positions: NDArray[np.int64],
    alphas: NDArray[np.uint8],
    colors: NDArray[np.uint8],
    scales: NDArray[np.uint8],
    rotations: NDArray[np.uint8],
    sh: NDArray[np.uint8],
) -> bytes:
    """Return the attributes of an SPZ file one after another; positions are 24-bit integers."""
    fixed = b"".join(int(v).to_bytes(3, "little", signed=True) for v in positions.ravel())
    return fixed + b"".join(part.astype(np.uint8).tobytes() for part in (alphas, colors, scales, rotations, sh))


def spz_bytes(
    payload: bytes, count: int, version: int = 3, degree: int = 0, fractional_bits: int = 12, flags: int = 0
) -> bytes:
    """Return a gzipped SPZ file."""
    header = struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, fractional_bits, flags, 0)
    return gzip.compress(header + payload, mtime=0)


def random_spz(version: int, degree: int, count: int = 9, seed: int = 0) -> tuple[bytes, int]:
    """Return random attributes of visible Gaussians, for ``spz_bytes`` to wrap, and the number of Gaussians."""
    rng = np.random.default_rng(seed)
    width = 3 if version == 2 else 4
    payload = spz_payload(
        positions=rng.integers(-(1 << 23), 1 << 23, (count, 3)),
        alphas=rng.integers(1, 256, count).astype(np.uint8),
        colors=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        scales=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        rotations=rng.integers(0, 256, (count, width)).astype(np.uint8),
        sh=rng.integers(0, 256, (count, (degree + 1) ** 2 - 1, 3)).astype(np.uint8),
    )
    return payload, count


def spz_4_bytes(
    payload: bytes, count: int, degree: int = 0, extension: bytes = b"", claims: Mapping[str, int] = {}
) -> bytes:
    """Return an SPZ file of version 4; ``claims`` replace true values in the header."""
    import imagecodecs

    widths = [width for width in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)) if width]
    ends = np.cumsum(widths) * count
    parts = [payload[end - width * count : end] for width, end in zip(widths, ends, strict=True)]
    streams = [imagecodecs.zstd_encode(part) for part in parts]
    fields = {"version": 4, "count": count, "degree": degree, "fractional_bits": 12, "flags": 0}
    fields |= {"streams": len(parts), "contents": 32 + len(extension), **claims}
    header = struct.pack("<4sIIBBBBI12x", b"NGSP", *fields.values())
    table = b"".join(struct.pack("<QQ", len(one), len(part)) for one, part in zip(streams, parts, strict=True))
    return header + extension + table + b"".join(streams)


def splat_bytes(
    means: Sequence[Sequence[float]],
    scales: Sequence[Sequence[float]],
    rgba: Sequence[Sequence[int]],
    quats: Sequence[Sequence[int]],
) -> bytes:
    """Return the records of a .splat file."""
    rows = zip(means, scales, rgba, quats, strict=True)
    return b"".join(struct.pack("<6f", *m, *s) + bytes([*c, *q]) for m, s, c, q in rows)


CHUNK_NAMES = "min_x min_y min_z max_x max_y max_z min_scale_x min_scale_y min_scale_z max_scale_x max_scale_y"
CHUNK_NAMES += " max_scale_z min_r min_g min_b max_r max_g max_b"


def compressed_ply_bytes(
    chunks: NDArray[np.float64], packed: NDArray[np.uint32], sh: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a compressed PLY file: chunks [C, 18], packed position, rotation, scale and colour [N, 4], sh [N, 3 K]."""
    header = ["ply", "format binary_little_endian 1.0", f"element chunk {len(chunks)}"]
    header += [f"property float {name}" for name in CHUNK_NAMES.split()]
    header += [f"element vertex {len(packed)}"]
    header += [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    if sh is not None:
        header += [f"element sh {len(sh)}", *(f"property uchar f_rest_{i}" for i in range(sh.shape[1]))]
    header += ["end_header", ""]
    body = chunks.astype("<f4").tobytes() + packed.astype("<u4").tobytes() + (b"" if sh is None else sh.tobytes())
    return "\n".join(header).encode() + body


def zip_bytes(entries: Mapping[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """Return a ZIP bundle with correct checksums."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as bundle:
        for name, content in entries.items():
            bundle.writestr(zipfile.ZipInfo(name), content, compression)
    return stream.getvalue()


def lying_zip(name: str, content: bytes, declared: int, compression: int) -> bytes:
    """Return a ZIP bundle whose only entry declares another size, and the checksum of as much of its content."""
    archive = bytearray(zip_bytes({name: content}, compression))
    central = archive.rindex(b"PK\x01\x02")
    told = struct.pack("<I", zlib.crc32(content[:declared]))
    for header, offset in ((0, 14), (central, 16)):
        archive[header + offset : header + offset + 4] = told
        archive[header + offset + 8 : header + offset + 12] = struct.pack("<I", declared)
    return bytes(archive)


def sog_meta(count: int, bands: int = 0) -> dict[str, object]:
    """Return the meta.json of a SOG bundle; log scales start at -5, degree-0 harmonics at -1, the others at -0.5."""
    book = np.linspace(-1.0, 1.0, 256)
    meta: dict[str, object] = {
        "version": 2,
        "count": count,
        "means": {"mins": [-1.0, -2.0, -3.0], "maxs": [1.0, 2.0, 3.0], "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": (book - 4.0).tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": book.tolist(), "files": ["sh0.webp"]},
    }
    if bands:
        files = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"count": 64, "bands": bands, "codebook": (0.5 * book).tolist(), "files": files}
    return meta


def sog_entries(count: int = 6, bands: int = 0, seed: int = 0) -> tuple[dict[str, bytes], dict[str, NDArray[np.uint8]]]:
    """Return the entries of a SOG bundle and the pixels [h, w, 4] that they encode."""
    import imagecodecs

    rng = np.random.default_rng(seed)
    names = ["means_l", "means_u", "quats", "scales", "sh0"]
    pixels = {name: rng.integers(0, 256, (2, 4, 4)).astype(np.uint8) for name in names}
    pixels["quats"][..., 3] = rng.integers(252, 256, (2, 4))
    pixels["sh0"][..., 3] |= 1
    if bands:
        pixels["shN_labels"] = rng.integers(0, 64, (2, 4, 4)).astype(np.uint8)
        pixels["shN_labels"][..., 1] = 0
        pixels["shN_centroids"] = rng.integers(0, 256, (1, 64 * ((bands + 1) ** 2 - 1), 4)).astype(np.uint8)
    for image in pixels.values():
        image[..., 3] = np.maximum(image[..., 3], 1)  # encoders may drop the colour of transparent pixels
    entries = {"meta.json": json.dumps(sog_meta(count, bands)).encode()}
    for name, image in pixels.items():
        entries[f"{name}.webp"] = imagecodecs.webp_encode(image, lossless=True)
    return entries, pixels
