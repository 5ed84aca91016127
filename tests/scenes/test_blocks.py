"""Folders of blocks: how they are read, written and refused."""

from pathlib import Path

import numpy as np
import pytest
import torch

from splatrl.collision import Occupancy
from splatrl.collision.point_clouds import write_points
from splatrl.renderers.packed_blocks import Packing
from splatrl.scenes import Gaussians, Scene, read_scene, similarity, write_gaussians
from splatrl.scenes.blocks import BLOCKS_FILE, MOST_BLOCKS, BlockScene, read_blocks_description
from splatrl.scenes.gaussians import INVISIBLE
from splatrl.scenes.scene import FreeSpace, robust_bounds
from splatrl.scenes.splitting import AROUND, write_split
from tests.renderers.cases import random_gaussians

BOUNDS = "[[0, 0, 0], [1, 1, 1]]"
LINE = f"blocks: [{{splat: a.ply, bounds: {BOUNDS}}}]"


def folder_with(tmp_path: Path, text: str) -> Path:
    """Return a folder with two splats and a ``blocks.yaml`` of this text."""
    for seed, name in enumerate("ab"):
        write_gaussians(tmp_path / f"{name}.ply", random_gaussians(seed, 20, degree=seed))
    (tmp_path / BLOCKS_FILE).write_text(text)
    return tmp_path


def in_order(gaussians: Gaussians) -> Gaussians:
    """Return the same Gaussians, ordered by x."""
    ordered: Gaussians = gaussians[gaussians.means[:, 0].argsort()]
    return ordered


def test_a_block_lies_where_its_frame_says(tmp_path: Path) -> None:
    frame = "world_from_splat: {axes: [x, -z, y], scale: 2.0, translation: [1, 2, 3]}"
    other = f"  - {{splat: b.ply, bounds: [[-9, 0, 0], [1, 5, 1]], {frame}}}"
    scene = read_scene(folder_with(tmp_path, f"blocks:\n  - {{splat: a.ply, bounds: {BOUNDS}}}\n{other}"))
    assert isinstance(scene, BlockScene)
    assert scene.name == tmp_path.name
    assert scene.bounds == ((-9, 0, 0), (1, 5, 1))
    first, second = (read() for read in scene.pieces)
    moved = random_gaussians(1, 20, 1).transformed(similarity(["x", "-z", "y"], 2.0, [1.0, 2.0, 3.0]))
    torch.testing.assert_close(first.means, random_gaussians(0, 20).means)
    for name in ("means", "scales", "sh"):
        torch.testing.assert_close(getattr(second, name), getattr(moved, name), rtol=1e-4, atol=1e-5)
    assert len(scene.gaussians) == 40
    assert scene.gaussians.sh_degree == 1
    assert not scene.gaussians.sh[:20, 1:].any()


def test_the_digest_depends_on_files_and_frames(tmp_path: Path) -> None:
    texts = [LINE, LINE.replace("bounds", "world_from_splat: {scale: 2.0}, bounds"), LINE.replace("a.ply", "b.ply")]
    digests = [read_scene(folder_with(tmp_path, text)).digest for text in texts]
    write_gaussians(tmp_path / "b.ply", random_gaussians(3, 20))
    assert len({*digests, read_scene(tmp_path).digest}) == 4
    assert read_scene(folder_with(tmp_path, texts[0])).digest == digests[0]


def test_a_block_that_changes_while_it_is_in_use_is_refused_and_never_cached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPLATRL_CACHE", str(tmp_path / "cache"))
    scene = read_scene(folder_with(tmp_path, LINE))
    assert isinstance(scene, BlockScene) and scene.digest
    write_gaussians(tmp_path / "a.ply", random_gaussians(3, 20))
    for use in (
        lambda: Packing(False, (0.0, 0.0, 0.0), True).packed(scene.blocks[0]),
        lambda: scene.cached("means", {}, lambda: {"means": scene.gaussians.means.numpy()}),
    ):
        with pytest.raises(ValueError, match=r"a\.ply: expected a file that stays as it is while .* got a changed one"):
            use()
    assert not list((tmp_path / "cache").glob("*"))
    assert len(read_scene(tmp_path).gaussians) == 20  # opened anew


def test_a_scene_yaml_in_the_folder_takes_precedence(tmp_path: Path) -> None:
    (folder_with(tmp_path, LINE) / "scene.yaml").write_text("splat: b.ply")
    assert not isinstance(read_scene(tmp_path), BlockScene)


def test_keys_of_the_whole_scene_are_read_and_can_be_overridden(tmp_path: Path) -> None:
    stated = f"name: town\nbounds: [[-1, -1, 0], [2, 2, 2]]\nrobot_height: 0.5\ngoal: [1, 2, 90]\n{LINE}"
    folder = folder_with(tmp_path, stated)
    scene, other = read_scene(folder), read_scene(folder, bounds=[[0, 0, 0], [3, 3, 3]], name="other")
    assert (scene.name, scene.bounds) == ("town", ((-1, -1, 0), (2, 2, 2)))
    assert (other.name, other.bounds) == ("other", ((0, 0, 0), (3, 3, 3)))
    assert read_blocks_description(folder)["goal"] == [1, 2, 90]
    with pytest.raises(ValueError, match=r"world_from_splat: expected none, since .*states where each block lies"):
        read_scene(folder, world_from_splat={"scale": 2.0})


def test_space_that_blocks_state_to_be_free_is_not_solid_in_any_block(tmp_path: Path) -> None:
    frame = "world_from_splat: {translation: [4.0, 0.0, 0.0]}"
    blocks = f"{LINE[:-1]}, {{splat: b.ply, bounds: [[4, 0, 0], [5, 1, 1]], {frame}}}]"
    folder = folder_with(tmp_path, blocks)
    every = Occupancy.from_scene(read_scene(folder), resolution=0.1)
    cleared = every.centers()[::3]
    write_points(folder / "haze.ply", cleared)
    (folder / BLOCKS_FILE).write_text(f"free: haze.ply\nvoxel_size: 0.1\n{blocks}")
    scene = read_scene(folder)
    assert scene.free == FreeSpace(folder / "haze.ply", 0.1)
    some = Occupancy.from_scene(scene, resolution=0.1)
    assert every.count - some.count == len(cleared) > 2 and not some.contains(cleared).any()
    (folder / BLOCKS_FILE).write_text(f"free: haze.ply\n{blocks}")
    with pytest.raises(ValueError, match=r"blocks\.yaml: free: expected voxel_size to be stated with it"):
        read_scene(folder)


def test_blocks_of_unknown_scale_give_a_warning(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, f"metric: false\n{LINE}")
    with pytest.warns(UserWarning, match="not metric: its scale is unknown"):
        read_scene(folder)


MALFORMED = {
    "no blocks": ("name: town", r"blocks: expected a list of 1 to 1,024 blocks, got None"),
    "an empty list": ("blocks: []", r"blocks: expected a list of 1 to 1,024 blocks, got 0"),
    "a string": ("blocks: a.ply", r"blocks: expected a list of 1 to 1,024 blocks, got 'a.ply'"),
    "no keys": ("- a.ply", r"blocks.yaml: expected keys and values"),
    "an unknown key": (f"{LINE}\ncolour: red", r"expected the keys name, bounds, .*, got colour"),
    "free space in another folder": (
        f"{LINE}\nvoxel_size: 0.1\nfree: ../free.ply",
        r"free: expected the name of a file",
    ),
    "a block that is a string": ("blocks: [a.ply]", r"blocks\[0\]: expected the keys splat, bounds"),
    "a block with another key": (LINE.replace("bounds", "at"), r"blocks\[0\]: expected the keys .*, got at"),
    "a relative path": (
        LINE.replace("a.ply", "../a.ply"),
        r"blocks\[0\].splat: expected a name, without slashes, got '../a.ply'",
    ),
    "an absolute path": (LINE.replace("a.ply", "/a.ply"), r"blocks\[0\].splat: expected a name, without slashes"),
    "the parent folder": (LINE.replace("a.ply", ".."), r"blocks\[0\].splat: expected a name"),
    "no splat": (f"blocks: [{{bounds: {BOUNDS}}}]", r"blocks\[0\].splat: expected a name, without slashes, got None"),
    "a missing file": (
        LINE.replace("a.ply", "c.ply"),
        r"blocks\[0\].splat: expected a file in this folder, found no c",
    ),
    "inverted bounds": (
        LINE.replace("1, 1, 1", "1, 1, -1"),
        r"blocks\[0\].bounds: expected lower below upper along z",
    ),
    "bounds beyond any place": (
        LINE.replace("[1, 1, 1]", "[1.7e308, 1, 1]"),
        r"blocks.yaml: blocks\[0\].bounds: expected numbers from -1e\+15 to 1e\+15, got",
    ),
    "no bounds": ("blocks: [{splat: a.ply}]", r"blocks\[0\].bounds: expected a lower and an upper corner"),
    "bounds with a string": (
        LINE.replace("1, 1, 1", "1, 1, high"),
        r"blocks\[0\].bounds: expected a lower and an upper corner",
    ),
    "an unknown frame key": (
        LINE.replace("bounds", "world_from_splat: {turn: 3}, bounds"),
        r"blocks\[0\].world_from_splat: expected the keys axes, .* got turn",
    ),
    "a frame that is a number": (
        LINE.replace("bounds", "world_from_splat: 3, bounds"),
        r"blocks\[0\].world_from_splat: expected keys and values, got 3",
    ),
    "a reflection": (
        LINE.replace("bounds", "world_from_splat: {axes: [x, y, -z]}, bounds"),
        r"blocks\[0\].world_from_splat: .*reflection",
    ),
    "a goal of one number": (f"{LINE}\ngoal: [1]", r"goal: expected \[x, y, yaw\]"),
    "a name with a slash": (f"{LINE}\nname: a/b", r"name: expected a name, without slashes"),
    "flat bounds of the whole scene": (
        f"{LINE}\nbounds: [[0, 0, 0], [1, 0, 1]]",
        r"blocks.yaml: bounds: expected lower below",
    ),
}


@pytest.mark.parametrize(("text", "message"), MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_file_is_refused_in_one_line_that_names_file_and_key(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises((ValueError, FileNotFoundError), match=message) as refused:
        read_scene(folder_with(tmp_path, text))
    assert BLOCKS_FILE in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("count", "message"),
    [(MOST_BLOCKS + 1, r"expected a list of 1 to 1,024 blocks, got 1,025"), (10000, r"expected at most 262,144 bytes")],
)
def test_thousands_of_blocks_are_refused_before_any_is_opened(tmp_path: Path, count: int, message: str) -> None:
    line = "  - {splat: gone.ply}         \n"
    with pytest.raises(ValueError, match=message):
        read_scene(folder_with(tmp_path, f"blocks:\n{line * count}"))


def test_splitting_loses_no_gaussian_and_states_the_bounds_of_each_block(tmp_path: Path) -> None:
    cloud = random_gaussians(4, 400, degree=1)
    cloud.opacities[:3] = 0.5
    cloud.means[:3] = torch.tensor([[90.0, 0.0, 0.0], [0.01, -80.0, 5.0], [0.02, 0.0, 2.0]])
    scene = Scene("cloud", cloud, ((-1.0, -0.5, -2.0), (1.0, 0.5, 2.0)))
    names = write_split(tmp_path, scene, 1.0, proposals={"robot_height": 0.5})
    blocks = read_scene(tmp_path)
    assert isinstance(blocks, BlockScene)
    assert blocks.bounds == scene.bounds
    assert {block.splat.name for block in blocks.blocks} == set(names)
    for block in blocks.blocks:
        means, (low, high) = block.read().means, block.bounds
        assert ((means >= torch.tensor(low) - 1e-4) & (means <= torch.tensor(high) + 1e-4))[:, :2].all(), block.splat
        assert block.splat.stem == AROUND or high[0] - low[0] == pytest.approx(1.0)
    around = next(block for block in blocks.blocks if block.splat.stem == AROUND)
    assert {90.0, -80.0} <= set(around.read().means[:, :2].flatten().tolist())
    whole, cut = in_order(cloud[cloud.opacities >= INVISIBLE]), in_order(blocks.gaussians)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        torch.testing.assert_close(getattr(cut, name), getattr(whole, name), rtol=1e-5, atol=1e-6)
    assert read_blocks_description(tmp_path)["robot_height"] == 0.5


@pytest.mark.parametrize(
    ("move", "stretch", "stray"),
    [
        ([0.0, 0.0, 0.0], [1.0, 1.0, 0.0], None),
        ([500_000.0, -40_000.0, 300.0], [1.0, 1.0, 0.0], None),
        ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [20_000.5, 3.0, 1.0]),
    ],
    ids=["planar", "planar and far away", "one stray"],
)
def test_every_scene_that_is_split_can_be_read(
    move: list[float], stretch: list[float], stray: list[float] | None, tmp_path: Path
) -> None:
    cloud = random_gaussians(4, 100)
    cloud.means = cloud.means * torch.tensor(stretch) + torch.tensor(move)
    if stray is not None:
        cloud.means[0] = torch.tensor(stray)
        cloud.opacities[0] = 0.2
    scene = Scene("cloud", cloud, robust_bounds(cloud))
    write_split(tmp_path, scene, 3.0)
    read = read_scene(tmp_path)
    stated, expected = np.array(read.bounds), np.array(scene.bounds)
    longest = (expected[1] - expected[0]).max()
    solid = expected[1] > expected[0]
    np.testing.assert_allclose(stated[:, solid], expected[:, solid], rtol=0, atol=1e-4 * longest)
    assert (np.float32(stated[1]) > np.float32(stated[0])).all()
    assert len(read.gaussians) == 100


def test_the_surroundings_are_the_blocks_near_the_bounds(tmp_path: Path) -> None:
    lines = [f"  - {{splat: {name}.ply, bounds: [[{x}, 0, 0], [{x + 4}, 4, 1]]}}" for name, x in (("a", 0), ("b", 6))]
    folder = folder_with(tmp_path, "blocks:\n" + "\n".join(lines))
    assert len(read_scene(folder).surroundings) == 40
    assert len(read_scene(folder, bounds=[[0, 0, 0], [3, 3, 1]]).surroundings) == 20
    assert len(read_scene(folder, bounds=[[90, 0, 0], [93, 3, 1]]).surroundings) == 40
    plain = Scene("cloud", random_gaussians(4, 50), ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    assert plain.surroundings is plain.gaussians


def test_a_split_size_that_is_too_small_is_refused(tmp_path: Path) -> None:
    scene = Scene("cloud", random_gaussians(4, 2000), ((-3.0, -3.0, -2.0), (3.0, 3.0, 2.0)))
    with pytest.raises(ValueError, match=r"--split: expected at most 1,024 blocks, got .* choose a larger size"):
        write_split(tmp_path, scene, 0.05)
    with pytest.raises(ValueError, match="--split: expected a number of at least"):
        write_split(tmp_path, scene, 0.0)
    assert not list(tmp_path.iterdir())
