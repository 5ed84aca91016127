"""Positions that a PLY holds as doubles, such as map coordinates, keep their millimetres when they are moved."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatrl.commands import scene as scene_command
from splatrl.geometry import axis_rotations, rigid
from splatrl.scenes import Gaussians, read_gaussians, read_scene, write_gaussians
from splatrl.scenes.blocks import Block
from splatrl.scenes.frame import similarity
from tests.scenes.samples import ply_fields, sample_gaussians
from tests.tiny import tiny_gaussians

PLACE = np.array([500_000.25, 5_400_000.125, 431.5])
"""Metres east, north and up: single precision rounds them to 0.03 and 0.5 m."""
SHIFT = {"translation": (-PLACE).tolist()}


def doubles(path: Path, gaussians: Gaussians, at: np.ndarray = PLACE, kind: str = "binary_little_endian") -> Path:
    """Write a PLY whose positions have double precision and whose other fields have single precision."""
    fields: dict[str, Any] = ply_fields(gaussians)
    fields |= {name: fields[name].astype(np.float64) + at[i] for i, name in enumerate("xyz")}
    rows = np.rec.fromarrays([*fields.values()], dtype=[(n, "<f8" if n in "xyz" else "<f4") for n in fields])
    types = [f"property {'double' if name in 'xyz' else 'float'} {name}" for name in fields]
    header = ["ply", f"format {kind} 1.0", f"element vertex {len(rows)}", *types, "end_header", ""]
    body = rows.tobytes()
    if kind == "ascii":
        body = "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in rows).encode()
    path.write_bytes("\n".join(header).encode() + body)
    return path


@pytest.mark.parametrize("kind", ["binary_little_endian", "ascii"])
def test_a_scene_is_moved_before_its_positions_are_rounded(kind: str, tmp_path: Path) -> None:
    near = sample_gaussians(50, 1)
    scene = read_scene(doubles(tmp_path / "a.ply", near, kind=kind), world_from_splat=SHIFT)
    assert scene.gaussians.means.dtype == torch.float32
    torch.testing.assert_close(scene.gaussians.means, near.means, atol=1e-6, rtol=0.0)


def test_blocks_and_scene_folders_are_moved_before_their_positions_are_rounded(tmp_path: Path) -> None:
    near = sample_gaussians(50, 0)
    path = doubles(tmp_path / "a.ply", near)
    block = Block(path, ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), similarity(**SHIFT))
    (tmp_path / "scene.yaml").write_text(f"splat: a.ply\nworld_from_splat: {{translation: {SHIFT['translation']}}}\n")
    for moved in (block.read(), read_scene(tmp_path).gaussians):
        torch.testing.assert_close(moved.means, near.means, atol=1e-6, rtol=0.0)


def test_without_a_frame_positions_are_single_precision_and_out_of_range_ones_are_dropped(tmp_path: Path) -> None:
    near = sample_gaussians(4, 0)
    assert read_gaussians(doubles(tmp_path / "a.ply", near, 0 * PLACE)).means.dtype == torch.float32
    near.means[1, 2] = torch.inf
    with pytest.warns(UserWarning, match="dropped 1 non-finite"):
        assert len(read_gaussians(doubles(tmp_path / "a.ply", near, 0 * PLACE))) == 3
    with pytest.raises(ValueError, match="expected at least one finite, visible Gaussian"):
        read_gaussians(doubles(tmp_path / "b.ply", sample_gaussians(4, 0), np.array([0.0, 0.0, 1e200])))


@pytest.mark.usefixtures("ungrounded")
def test_splatrl_scene_applies_an_offset_before_positions_are_rounded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = doubles(tmp_path / "a.ply", tiny_gaussians())
    x, y, z = SHIFT["translation"]
    frames = [
        ["--axes=x,y,z", "--scale=1", f"--translation={x},{y},{z}"],
        [f"--matrix=1,0,0,{x},0,1,0,{y},0,0,1,{z},0,0,0,1"],
    ]
    for words, out in [(frames[0], "a"), (frames[1], "b"), (frames[0], "c.spz")]:
        scene_command.main([str(path), *words, "--height=0.5", "--out", str(tmp_path / out)])
        assert "note" not in capsys.readouterr().err
        moved = read_scene(tmp_path / out.removesuffix(".spz")).gaussians
        torch.testing.assert_close(moved.means, tiny_gaussians().means, atol=1e-3, rtol=0.0)


def test_doubles_that_remain_far_from_the_origin_give_a_warning_with_advice(tmp_path: Path) -> None:
    near = sample_gaussians(50, 0)
    with pytest.warns(UserWarning, match="or, for a PLY with doubles, with world_from_splat.translation"):
        read_gaussians(doubles(tmp_path / "a.ply", near))


@pytest.mark.usefixtures("ungrounded")
@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_splatrl_scene_moves_the_origin_of_doubles_on_its_own(
    tilt: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    leaning = rigid(axis_rotations(0, torch.tensor(tilt, dtype=torch.float64)), torch.zeros(3, dtype=torch.float64))
    out = tmp_path / "out"
    scene_command.main([str(doubles(tmp_path / "a.ply", tiny_gaussians().transformed(leaning))), "--out", str(out)])
    said = capsys.readouterr()
    assert "origin      moved to [500000, 5400000, 432] of the file" in said.out
    assert "train in it" in said.out and "note" not in said.err
    found = read_scene(out).gaussians
    assert found.means.abs().max() < 5.0
    assert found.means[:, 2].quantile(0.02) == pytest.approx(0.0, abs=0.02)  # the floor
    between = [torch.pdist(each.means) for each in (found, tiny_gaussians())]
    torch.testing.assert_close(*between, atol=1e-3, rtol=0.0)


@pytest.mark.usefixtures("ungrounded")
def test_splatrl_scene_does_not_propose_to_train_in_what_single_precision_has_rounded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = tiny_gaussians()
    far.means += torch.tensor([4e6, 0.0, 0.0])
    write_gaussians(tmp_path / "a.ply", far)
    scene_command.main([str(tmp_path / "a.ply"), "--out", str(tmp_path / "out")])
    said = capsys.readouterr()
    assert said.out.splitlines()[-1].startswith("not fit to train in: half of its Gaussians lie more than 4e+06 units")
    assert "train in it" not in said.out and "subtract an offset" in said.err
