import json
import re
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.formats.reading import trained_antialiased
from splatrl.scenes.sources import read_scene
from splatrl.spherical_harmonics import C0
from tests.scenes.samples import assert_same, assert_valid, compressed_ply_bytes, sog_entries, sog_meta, zip_bytes

CHUNK = np.array([-1, -2, -3, 1, 2, 3, -5, -6, -7, -1, -2, -3, 0, 0.1, 0.2, 1, 0.9, 0.8], np.float64)
IDENTITY = 0b00_1000000000_1000000000_1000000000


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def packed(count: int) -> np.ndarray:
    """Return rows that alternate between the lower and the upper bounds of their chunk."""
    rows = np.zeros((count, 4), np.uint32)
    rows[:, 1] = IDENTITY
    rows[1::2, [0, 2, 3]] = 0xFFFFFFFF
    rows[::2, 3] = 0x000000FF
    return rows


@pytest.fixture
def gsply() -> None:
    pytest.importorskip("gsply", reason="needs the extra gsply")
    pytest.importorskip("imagecodecs", reason="needs the extra gsply")


@pytest.mark.usefixtures("gsply")
class TestCompressedPly:
    def test_packed_values_are_scaled_to_the_bounds_of_their_chunk(self, tmp_path: Path) -> None:
        path = written(tmp_path / "a.compressed.ply", compressed_ply_bytes(np.stack([CHUNK, 2 * CHUNK]), packed(258)))
        gaussians = read_gaussians(path)
        assert len(gaussians) == 258
        expected = torch.tensor([[-1.0, -2, -3], [1, 2, 3]])
        torch.testing.assert_close(gaussians.means[:2], expected)
        torch.testing.assert_close(gaussians.means[256:], 2 * expected)
        torch.testing.assert_close(gaussians.scales[:2].log(), torch.tensor([[-5.0, -6, -7], [-1, -2, -3]]))
        colors = 0.5 + C0 * gaussians.sh[:2, 0]
        torch.testing.assert_close(colors, torch.tensor([[0.0, 0.1, 0.2], [1.0, 0.9, 0.8]]), atol=1e-6, rtol=0)
        torch.testing.assert_close(gaussians.opacities, torch.ones(258), atol=1e-4, rtol=0)
        torch.testing.assert_close(gaussians.quats[:, 0], torch.ones(258), atol=1e-5, rtol=0)

    @pytest.mark.parametrize("newline", [b"\n", b"\r\n"])
    def test_colors_without_bounds_in_their_chunks_range_from_0_to_1(self, tmp_path: Path, newline: bytes) -> None:
        sh = np.arange(258 * 9, dtype=np.uint8).reshape(258, 9)
        chunks = np.stack([CHUNK, 2 * CHUNK])
        chunks[:, 12:] = 0, 0, 0, 1, 1, 1
        bounded = compressed_ply_bytes(chunks, packed(258), sh)
        start, body = bounded.split(b"end_header\n")
        start = re.sub(rb"property float (min|max)_[rgb]\n", b"", start) + b"end_header\n"
        older = start.replace(b"\n", newline) + chunks[:, :12].astype("<f4").tobytes() + body[chunks.size * 4 :]
        found = read_gaussians(written(tmp_path / "older.ply", older))
        assert_same(found, read_gaussians(written(tmp_path / "bounded.ply", bounded)))

    def test_harmonics_are_read_channel_by_channel(self, tmp_path: Path) -> None:
        sh = np.tile(np.arange(9, dtype=np.uint8) * 16 + 64, (3, 1))
        gaussians = read_gaussians(written(tmp_path / "a.ply", compressed_ply_bytes(CHUNK[None], packed(3), sh)))
        expected = (torch.arange(9).reshape(3, 3).T * 16 + 64 - 127.5) / 32
        torch.testing.assert_close(gaussians.sh[2, 1:], expected)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (b"element chunk 1", b"element chunk 2", "chunk: expected 1 rows, got 2"),
            (b"element vertex 3", b"element vertex 257", "chunk: expected 2 rows, got 1"),
            (b"element vertex 3", b"element vertex 4", "expected 136 bytes after the header, got 120"),
            (b"element vertex 3", b"element vertex 0", "chunk: expected 1 rows, got 1|vertex: expected 1 rows, got 0"),
            (b"little", b"big", "format: expected binary_little_endian, got binary_big_endian"),
            (b"packed_scale", b"packed_scald", "vertex: expected the uint properties packed_position"),
            (b"uint packed_color", b"int packed_color", "vertex: expected the uint properties packed_position"),
            (b"float max_b", b"uint max_b", "chunk: expected the float properties min_x"),
            (
                b"element vertex",
                b"element other 0\nelement vertex",
                "expected the elements chunk, vertex and optionally sh",
            ),
        ],
    )
    def test_a_layout_that_the_decoder_does_not_expect_is_refused(
        self, tmp_path: Path, old: bytes, new: bytes, message: str
    ) -> None:
        content = compressed_ply_bytes(CHUNK[None], packed(3)).replace(old, new)
        with pytest.raises(ValueError, match=rf"a\.ply: ({message})"):
            read_gaussians(written(tmp_path / "a.ply", content))

    @pytest.mark.parametrize("width", [3, 12])
    def test_a_wrong_number_of_harmonics_is_refused(self, tmp_path: Path, width: int) -> None:
        content = compressed_ply_bytes(CHUNK[None], packed(3), np.zeros((3, width), np.uint8))
        with pytest.raises(ValueError, match=rf"a\.ply: sh: expected 9, 24 or 45 properties, got {width}"):
            read_gaussians(written(tmp_path / "a.ply", content))


@pytest.mark.usefixtures("gsply")
class TestSog:
    def test_pixels_are_decoded_as_the_format_says(self, tmp_path: Path) -> None:
        entries, pixels = sog_entries(count=6, bands=1)
        gaussians = read_gaussians(written(tmp_path / "a.sog", zip_bytes(entries)))
        flat = {name: image.reshape(-1, 4)[:6].astype(np.float64) for name, image in pixels.items()}
        unit = (flat["means_l"] + 256 * flat["means_u"])[:, :3] / 65535
        logs = (2 * unit - 1) * np.array([1.0, 2.0, 3.0])
        np.testing.assert_allclose(gaussians.means, np.sign(logs) * np.expm1(np.abs(logs)), rtol=1e-4, atol=1e-6)
        book = np.linspace(-1.0, 1.0, 256)
        np.testing.assert_allclose(gaussians.scales.log(), book[pixels["scales"].reshape(-1, 4)[:6, :3]] - 4, atol=1e-5)
        np.testing.assert_allclose(gaussians.sh[:, 0], book[pixels["sh0"].reshape(-1, 4)[:6, :3]], atol=1e-6)
        np.testing.assert_allclose(gaussians.opacities, flat["sh0"][:, 3] / 255, atol=1e-5)
        palette = pixels["shN_centroids"][0, :, :3].reshape(64, 3, 3)
        labels = pixels["shN_labels"].reshape(-1, 4)[:6, 0]
        np.testing.assert_allclose(gaussians.sh[:, 1:], 0.5 * book[palette[labels]], atol=1e-6)
        three = (flat["quats"][:, :3] / 255 * 2 - 1) / np.sqrt(2)
        left_out = np.sqrt(np.maximum(0, 1 - (three**2).sum(1)))
        quats = [
            np.insert(t, int(tag) - 252, w) for t, tag, w in zip(three, flat["quats"][:, 3], left_out, strict=True)
        ]
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        np.testing.assert_allclose(gaussians.quats, quats, atol=1e-5)

    @pytest.mark.parametrize(
        ("keys", "value", "message"),
        [
            (("version",), 1, "version: expected 2, got 1"),
            (("count",), 9, "means: expected a texture of 9 pixels, got 4 by 2"),
            (("count",), True, "count: expected a whole number of at least 1, got True"),
            (("count",), 10**9, r"count: expected at most 16 unpacked bytes per .*; scene\.max_inflation raises"),
            (("means", "mins"), [0.0, 1.0], "means.mins: expected 3 numbers"),
            (("means", "maxs"), [0.0, 1.0, "x"], "means.maxs: expected finite numbers, got 'x'"),
            (("scales", "codebook"), [0.0] * 255, "scales.codebook: expected 256 numbers"),
            (("sh0", "codebook"), [10**400] * 256, "sh0.codebook: expected finite numbers"),
            (("quats",), None, "quats: expected a section of meta.json, got None"),
            (("quats", "files"), ["none.webp"], "none.webp: expected a lossless WebP texture, got b''"),
            (("quats", "files"), ["quats.webp"] * 2, "quats.files: expected 1 names"),
            (("quats", "files"), ["meta.json"], "meta.json: expected a lossless WebP texture"),
            (("shN", "bands"), 4, "shN.bands: expected 1, 2 or 3, got 4"),
            (("shN", "bands"), 2, "shN: expected centroids of 512 by 1 pixels, got"),
            (("shN", "count"), 65, "shN: expected centroids of 192 by 2 pixels, got"),
            (("shN", "count"), 0, "shN.count: expected 1 to 65536, got 0"),
            (("shN", "files"), ["shN_centroids.webp", "shN_centroids.webp"], None),
        ],
    )
    def test_a_meta_json_that_does_not_fit_is_refused_by_field(
        self, tmp_path: Path, keys: tuple[str, ...], value: object, message: str | None
    ) -> None:
        entries, _ = sog_entries(bands=1)
        meta = sog_meta(6, 1)
        section = meta
        for key in keys[:-1]:
            section = section[key]
        section[keys[-1]] = value
        path = written(tmp_path / "a.sog", zip_bytes({**entries, "meta.json": json.dumps(meta).encode()}))
        if message is None:  # a texture may be larger than it needs to be
            assert_valid(read_gaussians(path))
        else:
            with pytest.raises(ValueError, match=rf"a\.sog: .*{message}"):
                read_gaussians(path)

    @pytest.mark.parametrize(
        ("meta", "message"),
        [
            (b"[" * 100_000, "expected JSON"),
            (b"\xff\xfe", "expected JSON"),
            (b"{", "expected JSON"),
            (b"[]", "version: expected 2, got \\[\\]"),
            (b"{}", "version: expected 2, got None$"),
            (
                b'{"means": {}}',
                "version: expected 2, got None; this is version 1; convert it: .*-transform a.sog splat",
            ),
        ],
    )
    def test_a_meta_json_that_is_not_an_object_is_refused(self, tmp_path: Path, meta: bytes, message: str) -> None:
        with pytest.raises(ValueError, match=rf"a\.sog: meta\.json: {message}"):
            read_gaussians(written(tmp_path / "a.sog", zip_bytes({"meta.json": meta})))

    def test_the_error_for_a_bundle_without_meta_json_lists_its_entries(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"a\.sog: expected an entry meta\.json, got b\.txt"):
            read_gaussians(written(tmp_path / "a.sog", zip_bytes({"b.txt": b"x"})))

    def test_a_damaged_texture_is_refused(self, tmp_path: Path) -> None:
        entries, _ = sog_entries()
        entries["quats.webp"] = entries["quats.webp"][:30]
        with pytest.raises(ValueError, match=r"a\.sog: expected WebP textures, got a damaged one"):
            read_gaussians(written(tmp_path / "a.sog", zip_bytes(entries)))

    def test_a_file_that_is_not_a_zip_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"a\.sog: expected a ZIP bundle, got a damaged one"):
            read_gaussians(written(tmp_path / "a.sog", b"nothing of the kind"))

    def test_a_bundle_that_unpacks_to_far_more_than_its_size_is_not_unpacked(self, tmp_path: Path) -> None:
        import io
        import zipfile

        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as bundle:
            bundle.writestr("meta.json", bytes(1 << 26))
        path = written(tmp_path / "a.sog", stream.getvalue())
        tracemalloc.start()
        with pytest.raises(ValueError, match=r"a\.sog: .*67108864 bytes are more than"):
            read_gaussians(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1 << 24

    @pytest.mark.parametrize("bands", [0, 1])
    def test_an_unpacked_bundle_is_the_same_scene(self, tmp_path: Path, bands: int) -> None:
        entries, _ = sog_entries(bands=bands)
        packed = read_gaussians(written(tmp_path / "a.sog", zip_bytes(entries)))
        folder = tmp_path / "garden"
        folder.mkdir()
        for name, content in entries.items():
            written(folder / name, content)
        for path in (folder, folder / "meta.json"):
            assert_same(read_gaussians(path), packed)
        scene = read_scene(folder)
        assert scene.name == "garden"
        assert_same(scene.gaussians, packed)

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("../a.webp", "files: expected a name, without slashes"),
            ("/etc/passwd", "files: expected a name, without slashes"),
            (7, "files: expected a name, without slashes, got 7"),
            ("none.webp", "files: expected none.webp beside it, found none"),
        ],
    )
    def test_an_unpacked_bundle_names_only_files_beside_it(self, tmp_path: Path, name: object, message: str) -> None:
        entries, _ = sog_entries()
        for entry, content in entries.items():
            written(tmp_path / entry, content)
        meta = json.loads(entries["meta.json"])
        meta["quats"]["files"] = [name]
        with pytest.raises(ValueError, match=rf"meta\.json: {message}"):
            read_gaussians(written(tmp_path / "meta.json", json.dumps(meta).encode()))

    def test_more_gaussians_than_a_file_can_hold_need_to_be_allowed(self, tmp_path: Path) -> None:
        import imagecodecs

        entries, pixels = sog_entries()
        size = 1024
        for name in pixels:
            image = np.tile(pixels[name][:1, :1], (size, size, 1))
            entries[f"{name}.webp"] = imagecodecs.webp_encode(image, lossless=True)
        meta = json.loads(entries["meta.json"]) | {"count": size * size}
        path = written(tmp_path / "a.sog", zip_bytes({**entries, "meta.json": json.dumps(meta).encode()}))
        assert path.stat().st_size < 50_000
        with pytest.raises(
            ValueError, match=r"a\.sog: count: expected at most 16 unpacked bytes .*; scene\.max_inflation"
        ):
            read_gaussians(path)
        assert len(read_gaussians(path, max_inflation=1e6).means) == size * size

    @pytest.mark.parametrize("antialiased", [True, False, None])
    def test_a_bundle_says_whether_the_splat_was_trained_antialiased(
        self, tmp_path: Path, antialiased: bool | None
    ) -> None:
        meta = json.dumps({**sog_meta(6, 0), "antialias": antialiased}).encode()
        entries = {**sog_entries()[0], "meta.json": meta}
        assert trained_antialiased(written(tmp_path / "a.sog", zip_bytes(entries))) is antialiased
        written(tmp_path / "meta.json", meta)
        assert trained_antialiased(tmp_path) is antialiased

    def test_a_shared_sog_scene_is_read(self, shared_scenes: Path) -> None:
        gaussians = read_gaussians(shared_scenes / "playbot" / "playbot.sog")
        assert (len(gaussians), gaussians.sh_degree) == (125_000, 2)
        assert_valid(gaussians)


@pytest.mark.parametrize("module", ["gsply", "gsply.sog_reader", "imagecodecs"])
def test_the_error_without_the_extra_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    sog = module != "gsply"
    path = written(
        tmp_path / ("a.sog" if sog else "a.ply"), b"PK" if sog else compressed_ply_bytes(CHUNK[None], packed(3))
    )
    with pytest.raises(
        ImportError, match=r"a\.(sog|ply): this format needs the extra gsply: pip install 'splatrl\[gsply\]'"
    ):
        read_gaussians(path)
