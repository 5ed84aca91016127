import gzip
import re
import shutil
import sys
import warnings
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from PIL import Image

from splatrl.building import build_world
from splatrl.capture import inspection, suggestions
from splatrl.collision.occupancy import Occupancy
from splatrl.collision.point_clouds import write_points
from splatrl.commands.scene import main
from splatrl.configuration import load_config
from splatrl.evaluation.scene_pictures import survey_occupancy
from splatrl.scenes import Gaussians, read_gaussians, read_scene, similarity, write_gaussians
from splatrl.scenes.blocks import BlockScene, read_blocks_description
from splatrl.scenes.description import read_description
from splatrl.scenes.formats.reading import read_centred, trained_antialiased
from splatrl.scenes.scene import FreeSpace
from splatrl.scenes.upright import GUESS, SURE, Guess, Upright, guess_upright
from tests.preloaded import start
from tests.scenes.places import place, turned
from tests.scenes.samples import sog_entries
from tests.scenes.test_georeferenced import doubles
from tests.scenes.test_survey import BOXES, FLOOR, dataparser, lying, surfaces

UPRIGHT = ["x", "z", "-y"]
ROWS = "1 0 0 0  0 0 1 0  0 -1 0 1  0 0 0 1"


def world() -> Gaussians:
    """Return a yard whose colours vary, so that there is something to recognise."""
    result = surfaces([FLOOR, *BOXES])
    result.sh = torch.sin(3.0 * result.means).unsqueeze(1)
    return result


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    """A yard in a file with −y up and the floor at a height of 0.7."""
    folder = tmp_path / "yard"
    folder.mkdir()
    write_gaussians(folder / "yard.ply", lying(world(), similarity(UPRIGHT, 1.0, [0.0, 0.0, -0.7])))
    return folder / "yard.ply"


@pytest.fixture
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search for goals in only a few places."""
    monkeypatch.setattr("splatrl.capture.suggestions.MOST", 8)


@pytest.fixture
def few_pictures(few_places: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw only the view and the occupancy."""
    for name in ("evaluation.scene_pictures.draw_maps", "capture.inspection.draw_goals"):
        monkeypatch.setattr(f"splatrl.{name}", lambda *_: None)
    monkeypatch.setattr(inspection, "inspect_terrain", lambda *_: [])


def heights(folder: Path) -> tuple[float, float]:
    """Return the heights of the floor and of the highest box in a scene folder."""
    z = read_scene(folder).gaussians.means[:, 2]
    return float(z.median()), float(z.max())


@pytest.mark.usefixtures("few_places")
def test_a_splat_becomes_a_scene_folder_with_pictures_without_any_options(
    splat: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(splat)])
    printed = capsys.readouterr().out
    assert "up          -y" in printed
    assert "unknown: there is no ceiling" in printed
    assert "occupied  " in printed
    assert heights(splat.parent) == pytest.approx((0.0, 1.2), abs=0.02)
    assert "ground      z = " in printed and "boxes       " in printed
    pictures = [splat.with_name(f"yard-{kind}.png") for kind in ("free", "occupancy", "view", "ground")]
    for picture in pictures:
        assert str(picture) in printed
        assert len(np.unique(np.asarray(Image.open(picture)).reshape(-1, 3 if "view" in picture.name else 1))) > 1


@pytest.mark.usefixtures("ungrounded")
def test_a_folder_is_surveyed_again_in_the_frame_that_its_yaml_states(
    splat: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(splat)])
    description = splat.with_name("scene.yaml")
    edited = description.read_text().replace("scale: 1.0", "scale: 2.0")
    description.write_text(edited)
    capsys.readouterr()
    main([str(splat.parent)])
    said = capsys.readouterr().out
    assert "up          z" in said
    assert "floor       at 0 units along up; given: z = 0 in scene.yaml; the opaque layer is at" in said
    assert "given: scene.yaml states the scale, and that it is uncertain" in said
    assert description.read_text() == edited
    with pytest.raises(SystemExit, match=r"edit its scene\.yaml"):
        main([str(splat.parent), "--scale", "2"])


def test_a_folder_is_surveyed_again_with_the_solid_space_and_height_of_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "yard"
    folder.mkdir()
    write_gaussians(folder / "splat.ply", world())
    write_points(folder / "free.ply", survey_occupancy(read_scene(folder / "splat.ply"), 0.1).centers()[::3])
    keys = "robot_height: 0.7\nvoxel_size: 0.1\ncutoff: 0.91\nfree: free.ply\n"
    (folder / "scene.yaml").write_text(f"splat: splat.ply\n{keys}")
    seen: list[tuple[Occupancy, float]] = []

    def drawn(solid: Occupancy, height: float) -> list[Path]:
        seen.append((solid, height))
        return []

    monkeypatch.setattr(inspection, "draw_scene", lambda _, solid, __, height, *___: drawn(solid, height))
    monkeypatch.setattr(inspection, "inspect_terrain", lambda _, solid, __, height, ___: drawn(solid, height))
    main([str(folder)])
    main([str(folder), "--height=0.3"])
    of_scene = instantiate(load_config([f"scene={folder}/", "collision.occupancy.fill=null"]).collision.occupancy)
    assert [height for _, height in seen] == [0.7, 0.7, 0.3, 0.3]
    assert {solid.digest for solid, _ in seen} == {of_scene(read_scene(folder)).digest}


@pytest.mark.usefixtures("ungrounded")
def test_a_floor_far_below_zero_is_reported(splat: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main([str(splat), "--axes=x,z,-y", "--scale=1", "--translation=0,0,-46", "--height=0.4"])
    printed = capsys.readouterr().out
    assert re.search(
        r"goals +none: expected the floor at z = 0, got -4\d.* m; raise it with --matrix or --translation", printed
    )
    assert "robot_height" not in splat.with_name("scene.yaml").read_text()


def test_a_description_is_replaced_only_with_force_and_nothing_is_drawn_without(
    splat: Path, request: pytest.FixtureRequest
) -> None:
    splat.with_name("scene.yaml").write_text("mine")
    with pytest.raises(SystemExit, match="--force"):
        main([str(splat)])
    with pytest.raises(SystemExit, match=r"scene\.yaml: expected the keys .*, got mine; correct or remove the file"):
        main([str(splat), "--force"])
    assert splat.with_name("scene.yaml").read_text() == "mine"
    assert not splat.with_name("yard-view.png").exists()
    splat.with_name("scene.yaml").write_text("splat: yard.ply\n")
    request.getfixturevalue("ungrounded")
    main([str(splat), "--force"])
    assert read_scene(splat.parent).name == "yard"


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize(
    ("out", "words"),
    [("yard", []), ("out", []), ("out.spz", []), ("out", ["--split=1.5"]), ("out.spz", ["--split=1.5"])],
)
def test_what_a_person_wrote_stays_when_a_scene_is_inspected_again(
    splat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], out: str, words: list[str]
) -> None:
    arguments = [str(splat), "--axes=x,y,z", "--scale=1", *words, "--out", str(tmp_path / out)]
    folder = tmp_path / Path(out).stem
    description = folder / ("blocks.yaml" if words else "scene.yaml")
    main(arguments)
    mine = {"name": "Höfchen", "source": "Zoë, CC BY 4.0", "antialiased": False, "cutoff": 0.8}
    if description.name == "blocks.yaml" or out.endswith(".spz"):
        mine["name"] = "yard"  # by which the same splat is known
    estimated = description.read_text().replace('name: "yard"', f'name: "{mine["name"]}"')
    own = [f"{key}: {value}" for key, value in mine.items() if key != "name"]
    description.write_text("\n".join([*own, "metric: false", "robot_height: 7.0", estimated]))
    assert "keeps" not in capsys.readouterr().out
    main([*arguments, "--force"])
    said = "source, antialiased, cutoff as they were; what is estimated has been replaced"
    assert said in capsys.readouterr().out
    stated = (read_blocks_description if words else read_description)(folder)
    assert {key: stated[key] for key in mine} == mine
    assert "metric" not in stated and stated.get("robot_height") != 7.0


@pytest.mark.usefixtures("unproposed")
def test_what_a_person_wrote_about_another_splat_does_not_stay(splat: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "scene.yaml").write_text("splat: hall.ply\nname: hall\nsource: somebody else\n")
    main([str(splat), "--axes=x,y,z", "--scale=1", "--out", str(tmp_path / "out"), "--force"])
    stated = read_description(tmp_path / "out")
    assert stated["name"] == "yard" and "source" not in stated


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize("words", [[], ["--split=1.5"]])
def test_what_a_person_wrote_about_another_splat_that_was_converted_is_dropped_with_a_line(
    splat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    other = shutil.copy(splat, splat.with_name("hall.ply"))
    arguments = ["--axes=x,y,z", "--scale=1", *words, "--out", str(tmp_path / "out.spz")]
    main([str(other), *arguments])
    description = tmp_path / "out" / ("blocks.yaml" if words else "scene.yaml")
    description.write_text("source: somebody else\ncutoff: 0.8\n" + description.read_text())
    capsys.readouterr()
    main([str(splat), *arguments, "--force"])
    assert "drops       name, source, cutoff of the description that was there" in capsys.readouterr().out
    stated = (read_blocks_description if words else read_description)(tmp_path / "out")
    assert stated["name"] == "yard" and stated.keys().isdisjoint(("source", "cutoff"))


@pytest.mark.usefixtures("few_places")
def test_out_is_a_complete_scene_folder_and_the_files_own_folder_is_unchanged(
    splat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, described = tmp_path / "new" / "look", splat.with_name("scene.yaml")
    described.write_text("splat: yard.ply\n")
    main([str(splat), "--out", str(out)])
    pictures = ["goals.png", "yard-free.png", "yard-ground.png", "yard-occupancy.png", "yard-view.png"]
    assert sorted(path.name for path in out.iterdir()) == sorted(["scene.yaml", "yard.ply", *pictures])
    assert {path.name for path in splat.parent.iterdir()} == {"yard.ply", "scene.yaml"}
    assert (out / "yard.ply").read_bytes() == splat.read_bytes()
    said = capsys.readouterr().out
    assert f"not that of {described}; to keep that, name the folder: splatrl-scene {splat.parent}\n" in said
    assert f"splatrl-train scene={out}/" in said and "goal 1 " in said
    stated = read_description(out)
    assert stated["metric"] is False and stated["robot_height"] == pytest.approx(0.4, abs=0.02)
    (left, bottom), (right, top) = stated["walk"]
    x, y, _ = stated["goal"]
    assert left <= x <= right and bottom <= y <= top and 0.04 <= stated["voxel_size"] <= 0.06
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the scale is unknown
        world = build_world(
            load_config([f"scene={out}", "device=cpu", "robot.image_width=16", "robot.image_height=12"])
        )
    assert len(world.plan.start_rows) > 100


@pytest.mark.usefixtures("ungrounded")
@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize("name", ["a.ply", "A.PLY"])
def test_doubles_are_copied_as_they_are_whatever_the_case_of_the_extension(tmp_path: Path, name: str) -> None:
    splat = doubles(tmp_path / name, world())
    main([str(splat), "--axes=x,y,z", "--scale=1", "--out", str(tmp_path / "out")])
    assert (tmp_path / "out" / name).read_bytes() == splat.read_bytes()


@pytest.mark.usefixtures("ungrounded")
def test_a_large_place_has_longer_steps_coarser_voxels_and_a_larger_object(tmp_path: Path) -> None:
    file, _ = turned(place("courtyard", spacing=0.6), 3, tilt_deg=6.0)
    write_gaussians(tmp_path / "yard.ply", file)
    main([str(tmp_path / "yard.ply"), "--out", str(tmp_path / "mine"), "--height", "1.2"])
    stated = read_description(tmp_path / "mine")
    assert stated["step"] == 0.4 and stated["object_size"] == 0.64 and 0.05 < stated["voxel_size"] < 0.15
    lower, upper = np.array(stated["bounds"])
    assert (upper - lower).max() < 20.0  # where robots can be, not the courtyard's 40 m
    cfg = load_config([f"scene={tmp_path / 'mine'}", "task=apple"])
    assert (cfg.drawing.size, cfg.task.motion.step, cfg.robot.height) == (0.64, 0.4, stated["robot_height"])


@pytest.mark.parametrize(
    ("options", "floor", "top"),
    [
        (["--scale", "2"], 0.0, 2.4),
        (["--axes", "x", "z", "-y"], 0.0, 1.2),
        (["--up", "-y"], 0.0, 1.2),
        (["--up=-y", "--scale", "2"], 0.0, 2.4),
        (["--up", "0.1", "-1", "0.1"], 0.0, 1.2),
        (["--axes", "-x", "z", "y"], 1.2, 1.2),  # upside down: what was the floor is on top
        (["--axes=x,z,-y", "--scale", "0.5", "--translation", "1", "2", "-1e-1"], 0.25, 0.85),
        (["--axes", "x z -y", "--distance", "0 0 0  0 -2 0  3"], 0.0, 1.8),
        (["--distance", "-1", "0", "0", "-1", "0", "0.5", "1"], 0.0, 2.4),
        (["--translation", "0", "0", "5"], 5.7, 6.9),
        (["--matrix", *ROWS.split()], 1.7, 2.9),
        (["--matrix", ROWS, "--scale", "3"], 5.1, 8.7),
    ],
)
@pytest.mark.usefixtures("unproposed")
def test_options_take_precedence_over_the_guessed_frame(
    splat: Path, options: list[str], floor: float, top: float
) -> None:
    main([*options, str(splat)])
    assert heights(splat.parent) == pytest.approx((floor, top), abs=0.03)


@pytest.mark.usefixtures("unproposed")
def test_nerfstudios_own_frame_is_undone(tmp_path: Path) -> None:
    transforms = dataparser(tmp_path)
    moved = torch.tensor([[1.0, 0, 0, 0.5], [0, 0, -1, 2], [0, 1, 0, -1], [0, 0, 0, 4]], dtype=torch.float64) * 0.25
    write_gaussians(tmp_path / "splat.ply", world().transformed(moved))
    main([str(tmp_path / "splat.ply"), "--nerfstudio", str(transforms)])
    torch.testing.assert_close(read_scene(tmp_path).gaussians.means, world().means, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--axes", "x", "y"], "axes: expected 3"),
        (["--axes", "x", "z", "y"], "reflection"),
        (["--axes", "x y z", "--nerfstudio", "a.json"], "expected at most one of"),
        (["--up", "q"], "--up: expected one of x, -x, y, -y, z, -z, or 3 numbers, got 'q'"),
        (["--up", "0", "0", "0"], "--up: expected"),
        (
            ["--up", "-y", "--axes", "x y z"],
            "expected at most one of --axes, --matrix, --nerfstudio and --up, got --axes",
        ),
        (["--nerfstudio", "nowhere.json"], "found no file"),
        (["--scale", "1", "--distance", "0 0 0 1 0 0 1"], "got both"),
        (["--scale", "-1"], "--scale: expected a number above 0"),
        (["--height", "nan"], "--height: expected"),
        (["--distance", "0 0 0 0 0 0 1"], "two different points"),
        (["--distance", "0 0 0 1 0 0"], "expected 7 numbers, got 6"),
        (["--distance", "0 0 0 1 0 0 far"], "expected 7 numbers"),
        (["--matrix", " ".join("1" * 16)], "last row"),
        (["--matrix", "1 2"], "expected 16 numbers"),
        (
            ["--translation", "1 2 3", "--matrix", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"],
            "--translation: expected on its own",
        ),
        (["--resolution", "1e-5"], "resolution"),
    ],
)
def test_an_invalid_option_is_refused_in_one_line(splat: Path, options: list[str], message: str) -> None:
    with pytest.raises(SystemExit, match=message) as stopped:
        main([str(splat), *options])
    assert str(stopped.value).startswith("splatrl-scene: ")
    assert [path.name for path in splat.parent.iterdir()] == ["yard.ply"]


def test_missing_or_damaged_files_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"splatrl-scene: .*nowhere"):
        main([str(tmp_path / "nowhere.ply")])
    (tmp_path / "damaged.ply").write_bytes(b"ply\nnothing more")
    with pytest.raises(SystemExit, match=r"splatrl-scene: .*damaged"):
        main([str(tmp_path / "damaged.ply")])
    with pytest.raises(SystemExit, match="expected a scene folder"):
        main([str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.ply"]


def test_a_format_that_needs_an_extra_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsply.sog_reader", None)
    (tmp_path / "a.sog").write_bytes(b"PK")
    with pytest.raises(SystemExit, match=r"^splatrl-scene: .*a\.sog: this format needs the extra gsply: pip [^\n]*$"):
        main([str(tmp_path / "a.sog")])


def test_a_scene_far_from_the_origin_keeps_its_bounds(tmp_path: Path, ungrounded: None) -> None:
    gaussians = world()
    gaussians.means += torch.tensor([5000.0, -12345.0, 0.0])
    write_gaussians(tmp_path / "far.ply", gaussians)
    main([str(tmp_path / "far.ply"), "--axes", "x,y,z", "--out", str(tmp_path / "far")])
    write_gaussians(tmp_path / "near.ply", world())
    main([str(tmp_path / "near.ply"), "--axes", "x,y,z", "--out", str(tmp_path / "near")])
    far, near = (np.array(read_description(tmp_path / name)["bounds"]) for name in ("far", "near"))
    assert np.abs(far - near - [5000.0, -12345.0, 0.0]).max() < 0.3  # the voxel grid is offset


def test_the_printed_command_has_placeholders_for_what_was_not_found(
    tmp_path: Path, undrawn: None, capsys: pytest.CaptureFixture[str]
) -> None:
    gaussians = world()
    gaussians.opacities *= 0.05  # nothing is solid
    write_gaussians(tmp_path / "haze.ply", gaussians)
    for stated, height in ([], 0.4), (["--height", "1.05", "--force"], 1.05):
        main([str(tmp_path / "haze.ply"), "--out", str(tmp_path / "haze"), *stated])
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.endswith(f"haze/ robot.height={height} 'landmarks.goal=[x,y,yaw]'")


def test_a_place_in_which_nothing_can_be_recognised_is_said_to_have_no_goal(
    tmp_path: Path, few_pictures: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("splatrl.capture.suggestions._scores", lambda *_: np.zeros(suggestions.HEADINGS))
    write_gaussians(tmp_path / "yard.ply", world())
    main([str(tmp_path / "yard.ply"), "--out", str(tmp_path / "yard")])
    printed = capsys.readouterr().out.splitlines()
    assert "goals       none: nothing to recognise near a free place" in printed
    assert printed[-1].endswith("yard/ 'landmarks.goal=[x,y,yaw]'")
    assert "goal" not in read_description(tmp_path / "yard")


def test_a_folder_may_be_named_by_its_yaml(splat: Path, few_pictures: None, unproposed: None) -> None:
    main([str(splat)])
    before = (splat.parent / "scene.yaml").read_bytes()
    main([str(splat.parent / "scene.yaml")])  # looked at again, not replaced
    assert (splat.parent / "scene.yaml").read_bytes() == before
    assert read_scene(splat.parent / "scene.yaml").name == read_scene(splat.parent).name == "yard"


def test_a_place_of_implausible_size_and_a_place_in_blocks_are_refused_in_one_line(
    tmp_path: Path, undrawn: None
) -> None:
    gaussians = world()
    gaussians.means *= 5000.0
    gaussians.scales *= 5000.0
    write_gaussians(tmp_path / "large.ply", gaussians)
    with pytest.raises(SystemExit, match=r"voxels.*; if the scene is not .* m across, pass --scale or --distance"):
        main([str(tmp_path / "large.ply"), "--out", str(tmp_path / "large")])
    (tmp_path / "blocks.yaml").touch()
    with pytest.raises(SystemExit, match=r"a splat file or a folder with scene.yaml, got a folder with blocks.yaml"):
        main([str(tmp_path)])


def test_the_command_runs_as_a_module_and_prints_its_help() -> None:
    shown, _ = (program := start("-m", "splatrl.commands.scene", "--help")).communicate(60)
    assert program.returncode == 0
    assert "--nerfstudio" in shown


@pytest.mark.usefixtures("unproposed")
def test_the_kitchen_is_in_metres_with_its_floor_at_zero(shared_scenes: Path, tmp_path: Path) -> None:
    main([str(shared_scenes / "kitchen" / "kitchen.spz"), "--out", str(tmp_path)])
    written = (tmp_path / "scene.yaml").read_text()
    assert 'axes: ["x", "-z", "y"]' in written
    assert "scale: 1.0 " in written
    scene = read_scene(tmp_path)
    opaque = scene.gaussians.means[scene.gaussians.opacities > 0.5]
    assert ((opaque[:, 2].abs() < 0.03).float().mean()) > 0.2  # the floor is at least a fifth of the opaque Gaussians


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize(
    ("sign", "said"),
    [
        (GUESS, r"look at \S+/yard-view.png: if the place lies on its side there, or upside down, pass --up; if"),
        (SURE, "if"),
    ],
)
def test_the_view_is_to_be_looked_at_where_up_is_only_a_guess(
    splat: Path, sign: str, said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def guessed(*args: object) -> Upright:
        return replace(guess_upright(*args), sign_guess=Guess(sign, "by the test"))  # type: ignore[arg-type]

    monkeypatch.setattr("splatrl.scenes.stated.guess_upright", guessed)
    main([str(splat)])
    last = capsys.readouterr().out.splitlines()[-1]
    size = " the place is not 5.92 × 3.84 × 1.2 m, pass --distance or --scale; otherwise train in it: splatrl-train"
    assert re.match(said + size, last)
    main([str(splat), "--scale", "1.0", "--force"])
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("train in it") if sign == SURE else "pass --up; otherwise train in it" in last


@pytest.mark.usefixtures("unproposed")
def test_a_place_whose_scale_is_only_guessed_is_not_called_metric(tmp_path: Path) -> None:
    for height, metric in ((2.5, None), (12.0, False)):
        walls = [(0, 0, 0, 6, 0, height), (0, 0, 0, 0, 4, height), (6, 0, 0, 6, 4, height)]
        hall = surfaces([FLOOR, *BOXES, *walls, (0.0, 0.0, height, 6.0, 4.0, height)])
        write_gaussians(tmp_path / "hall.ply", hall)
        main([str(tmp_path / "hall.ply"), "--up", "z", "--force"])
        assert read_description(tmp_path).get("metric") is metric


def test_an_out_path_that_ends_in_spz_makes_a_folder_with_a_compressed_splat(
    splat: Path,
    tmp_path: Path,
    few_pictures: None,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
) -> None:
    main([str(splat), "--scale", "2", "--out", str(tmp_path / "small.spz")])
    assert f"wrote       {tmp_path / 'small' / 'splat.spz'}, 0.0 MB" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "small").iterdir()} > {"splat.spz", "scene.yaml", "yard-view.png"}
    small = read_scene(tmp_path / "small")
    request.getfixturevalue("undrawn")
    main([str(splat), "--scale", "2"])
    large = read_scene(splat.parent)
    torch.testing.assert_close(small.gaussians.means, large.gaussians.means, atol=2e-4, rtol=0)
    assert small.name == "yard" and small.bounds == large.bounds
    with pytest.raises(SystemExit, match="--force"):
        main([str(splat), "--out", str(tmp_path / "small.spz")])
    description = splat.with_name("scene.yaml")
    said = "\nmetric: true\nantialiased: false\nfree: free.ply\nsource: Zoë, CC BY 4.0\n"
    description.write_text(description.read_text() + said)
    write_points(splat.with_name("free.ply"), torch.rand(5, 3))
    main([str(splat.parent), "--out", str(tmp_path / "again.spz")])
    again = read_scene(tmp_path / "again")
    torch.testing.assert_close(again.gaussians.means, large.gaussians.means, atol=2e-4, rtol=0)
    stated = read_description(tmp_path / "again")
    assert (stated["metric"], stated["antialiased"], stated["source"]) == (True, False, "Zoë, CC BY 4.0")
    assert "Zoë" in (tmp_path / "again" / "scene.yaml").read_text(encoding="utf-8")
    kept = ("robot_height", "walk", "step", "goal", "object", "voxel_size")
    assert [stated.get(key) for key in kept] == [read_description(splat.parent).get(key) for key in kept]
    assert (tmp_path / "again" / "free.ply").read_bytes() == splat.with_name("free.ply").read_bytes()
    assert again.free is not None and again.free.voxel_size == stated["voxel_size"]
    assert gzip.decompress((tmp_path / "again" / "splat.spz").read_bytes())[14] == 0


@pytest.mark.usefixtures("ungrounded")
@pytest.mark.parametrize(("out", "ending"), [("town", ".ply"), ("town.spz", ".spz")])
def test_a_splat_is_split_into_blocks_that_together_make_up_the_scene(
    splat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], out: str, ending: str
) -> None:
    main([str(splat), "--split", "1.5", "--out", str(tmp_path / out)])
    folder = tmp_path / "town"
    assert f"train in it: splatrl-train scene={folder}/" in capsys.readouterr().out
    cut = read_scene(folder)
    assert isinstance(cut, BlockScene)
    assert len(cut.blocks) > 4
    assert {block.splat.suffix for block in cut.blocks} == {ending}
    assert not (folder / "scene.yaml").exists()
    assert heights(folder) == pytest.approx((0.0, 1.2), abs=0.02)
    assert len(cut.gaussians) == len(read_gaussians(splat))
    for words in (["--split", "1.5"], []):  # a scene.yaml beside them would hide the blocks
        with pytest.raises(SystemExit, match=r"blocks.yaml: already exists"):
            main([str(splat), *words, "--out", str(tmp_path / out)])


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize(
    ("out", "words", "theirs"),
    [
        ("out", [], "yard.ply"),
        ("out.spz", [], "splat.spz"),
        ("out", ["--split=1.5"], "block-7-7.ply"),
        ("out.spz", ["--split=1.5"], "around.spz"),
    ],
)
def test_files_of_others_are_replaced_only_with_force(
    splat: Path, tmp_path: Path, out: str, words: list[str], theirs: str
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / theirs).write_text("theirs")
    arguments = [str(splat), "--axes=x,y,z", "--scale=1", *words, "--out", str(tmp_path / out)]
    with pytest.raises(SystemExit, match=rf"{theirs}: already exists; choose another folder with --out, or pass --f"):
        main(arguments)
    assert (folder / theirs).read_text() == "theirs" and len(list(folder.iterdir())) == 1
    main([*arguments, "--force"])
    assert len(read_scene(folder).gaussians) == len(read_gaussians(splat))


@pytest.mark.usefixtures("unproposed")
def test_a_converted_scene_does_not_replace_free_space_of_others(splat: Path, tmp_path: Path) -> None:
    main([str(splat), "--axes=x,y,z", "--scale=1"])
    description = splat.with_name("scene.yaml")
    description.write_text(description.read_text() + "free: free.ply\nvoxel_size: 0.1\n")
    write_points(splat.with_name("free.ply"), torch.rand(5, 3))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "free.ply").write_text("theirs")
    with pytest.raises(SystemExit, match=r"free\.ply: already exists"):
        main([str(splat.parent), "--out", str(tmp_path / "out.spz")])
    assert (tmp_path / "out" / "free.ply").read_text() == "theirs"


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize("antialiased", [None, False, True])
def test_written_splats_say_how_their_source_was_trained(tmp_path: Path, antialiased: bool | None) -> None:
    """From PLY to SPZ and to blocks, and from SPZ and a folder on, while scene.yaml asks for nothing."""
    source = tmp_path / "yard.ply"
    write_gaussians(source, world(), antialiased)
    frame = ["--axes=x,y,z", "--scale=1"]
    main([str(source), *frame, "--out", str(tmp_path / "small.spz")])
    small = tmp_path / "small" / "splat.spz"
    assert trained_antialiased(small) is (antialiased is True)
    assert "antialiased" not in read_description(small.parent)
    main([str(small.parent), "--out", str(tmp_path / "again.spz")])
    assert trained_antialiased(tmp_path / "again" / "splat.spz") is (antialiased is True)
    main([str(source), *frame, "--split=20", "--out", str(tmp_path / "cut")])
    assert {trained_antialiased(path) for path in (tmp_path / "cut").glob("*.ply")} == {antialiased}


@pytest.mark.usefixtures("unproposed")
@pytest.mark.parametrize("typed", ["bundle", "bundle/meta.json"])
def test_an_unpacked_sog_becomes_a_scene_with_the_name_of_its_folder(tmp_path: Path, typed: str) -> None:
    for package in ("gsply", "imagecodecs"):
        pytest.importorskip(package)
    folder = tmp_path / "bundle"
    folder.mkdir()
    for name, content in sog_entries()[0].items():
        (folder / name).write_bytes(content)
    frame = ["--axes=x,y,z", "--scale=1"]
    main([str(tmp_path / typed), *frame, "--out", str(tmp_path / "out")])
    assert read_scene(tmp_path / "out").name == "bundle" == read_scene(tmp_path / typed).name
    main([str(tmp_path / typed), *frame])
    assert (folder / "scene.yaml").is_file() and read_scene(folder).name == "bundle"


@pytest.mark.usefixtures("ungrounded")
def test_blocks_are_not_written_into_a_folder_with_a_scene_yaml(splat: Path) -> None:
    main([str(splat)])
    with pytest.raises(SystemExit, match=r"--split: expected a folder without scene.yaml"):
        main([str(splat.parent), "--split", "2"])
    with pytest.raises(SystemExit, match="--split: expected a number above 0"):
        main([str(splat), "--split", "0", "--out", str(splat.parent / "town")])
    description = splat.with_name("scene.yaml")
    description.write_text(description.read_text() + "\nfree: haze.ply\n")
    write_points(splat.with_name("haze.ply"), torch.rand(5, 3))
    main([str(splat.parent), "--split", "2", "--out", str(splat.parent / "town")])
    cut = read_scene(splat.parent / "town")
    assert isinstance(cut, BlockScene)
    assert cut.free == FreeSpace(splat.parent / "town" / "free.ply", read_description(splat.parent)["voxel_size"])
    assert cut.free.path.read_bytes() == splat.with_name("haze.ply").read_bytes()


@pytest.mark.usefixtures("few_pictures")
def test_a_splat_is_not_held_in_two_frames_while_its_scene_is_inspected(
    splat: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first: list[weakref.ref[torch.Tensor]] = []
    held: list[torch.Tensor | None] = []

    def reading(path: Path) -> tuple[Gaussians, list[float]]:
        gaussians, origin = read_centred(path)
        first.append(weakref.ref(gaussians.sh))
        return gaussians, origin

    def standing(*args: object, **kwargs: object) -> Gaussians:
        held.extend(each() for each in first)
        return read_gaussians(*args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr("splatrl.commands.scene.read_centred", reading)
    monkeypatch.setattr("splatrl.commands.scene.read_gaussians", standing)
    monkeypatch.setattr(sys, "argv", ["splatrl-scene", str(splat), "--scale", "1"])
    main()
    assert held == [None]
