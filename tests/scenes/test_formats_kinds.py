"""Files of other kinds than their extension says, and formats that are not read: refused with what to do."""

import gzip
from pathlib import Path

import pytest

from splatrl.scenes.formats import read_gaussians

CONVERT = "npx @playcanvas/splat-transform"
CONTENTS = {
    "a PLY": b"ply\n",
    "a PLY ": b"ply\r\n",
    "an SPZ": b"NGSP",
    "an SPZ or another gzip": gzip.compress(b"", mtime=0),
    "an SOG or another ZIP": b"PK\x03\x04",
    "a glTF": b"glTF",
}
OWN = {("an SPZ", ".spz"), ("an SPZ or another gzip", ".spz"), ("an SOG or another ZIP", ".sog")}
OWN |= {("a PLY", ".ply"), ("a PLY ", ".ply")}


@pytest.mark.parametrize(
    ("kind", "ending"),
    [(kind, end) for kind in CONTENTS for end in (".ply", ".spz", ".splat", ".sog") if (kind, end) not in OWN],
)
def test_another_kind_of_file_is_refused_even_if_its_size_fits(kind: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(CONTENTS[kind].ljust(160, b"7"))
    words = rf"a\{ending}: expected a \{ending}, got {kind.strip()}.*; give it the extension of its kind"
    with pytest.raises(ValueError, match=words):
        read_gaussians(path)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("my scan.ksplat", f"got .ksplat; convert it: {CONVERT} 'my scan.ksplat' splat.ply"),
        ("a.KSPLAT", f"got .ksplat; convert it: {CONVERT} a.KSPLAT splat.ply"),
        ("lod-meta.json", f"got a streamed SOG; convert it: {CONVERT} lod-meta.json splat.ply"),
        ("a.lcc", f"got .lcc; convert it: {CONVERT} a.lcc splat.ply"),
        ("a.glb", "got .glb; export it as a PLY or an SPZ from the program that made it"),
        ("a.gltf", "got .gltf; export it as a PLY or an SPZ from the program that made it"),
        ("a.splatv", "got .splatv; export it as a PLY or an SPZ from the program that made it"),
    ],
)
def test_a_format_that_is_not_read_is_refused_with_what_to_do(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"{}")
    with pytest.raises(ValueError) as refused:
        read_gaussians(tmp_path / name)
    assert words in str(refused.value)


def test_a_folder_with_a_streamed_sog_is_refused_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "lod-meta.json").write_text("{}")
    with pytest.raises(ValueError, match=rf"got a streamed SOG; convert it: {CONVERT}"):
        read_gaussians(tmp_path)
