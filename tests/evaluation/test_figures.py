"""The figures show the right numbers on the right scales."""

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor

from splatrl.envs.tasks import Mark
from splatrl.evaluation import start_maps, training_figures
from splatrl.evaluation.figure_style import GOAL, MISSED, OWN_FONT, PARTLY, REACHED, font, legible
from splatrl.evaluation.start_maps import start_map, success_map
from splatrl.evaluation.topdown import MapView, TopDown
from splatrl.evaluation.training_figures import learning_curve, scene_bars

GROUND = TopDown(torch.full((80, 120, 3), 200, dtype=torch.uint8), (-1.5, 1.5, -0.5, 1.5))
PLACE = torch.tensor([0.3, 0.7, 0.5], dtype=torch.float64)
VIEW = MapView(GROUND, marks=[Mark("goal pose", PLACE)])


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Collects figures instead of writing them."""
    collected: list[Figure] = []
    for module in (start_maps, training_figures):
        monkeypatch.setattr(module, "save_figure", lambda figure, path: collected.append(figure))
    return collected


def lattice(headings: int = 8) -> Tensor:
    """Return poses at 4 × 3 positions, 0.25 m apart, each with evenly spaced headings: [N, 3]."""
    yaws = torch.arange(headings, dtype=torch.float64) * math.tau / headings
    steps = torch.arange(4, dtype=torch.float64) * 0.25
    return torch.cartesian_prod(steps - 0.5, steps[:3], yaws)


def polygons(figure: Figure, color: str) -> np.ndarray:
    """Return the outlines with this colour on the map: [N, K, 2]."""
    sets = [c for c in figure.axes[0].collections if isinstance(c, PolyCollection) and len(c.get_facecolor())]
    chosen = [c for c in sets if to_hex(c.get_facecolor()[0]) == color]
    return np.concatenate([[path.vertices[:-1] for path in c.get_paths()] for c in chosen] or [np.zeros((0, 7, 2))])


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_learning_curve_shows_every_known_value(drawn: list[Figure]) -> None:
    history = [{"frames": 100.0 * i, "success": i / 10, "return": 2.0 * i, "level": 1 + i // 4} for i in range(1, 10)]
    history[2]["success"] = history[2]["return"] = math.nan
    history[4]["test_success"] = 0.6
    learning_curve(history, Path("unused.png"))
    above, below, levels = drawn[0].axes
    raw, smooth, test = above.lines
    known = [row["frames"] for row in history if not math.isnan(row["success"])]
    assert raw.get_xdata().tolist() == known and smooth.get_xdata().tolist() == known
    assert raw.get_ydata().tolist() == [0.1, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
    shown = ~np.isnan(test.get_ydata())
    assert test.get_xdata()[shown].tolist() == [500.0] and test.get_ydata()[shown].tolist() == [0.6]
    assert below.lines[0].get_ydata().tolist() == [2.0, 4.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0]
    assert levels.lines[0].get_xdata().tolist() == [0, 100, 200, 300, 400, 500, 600, 700, 800, 900]
    assert levels.lines[0].get_ydata().tolist() == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3]
    assert levels.lines[0].get_drawstyle() == "steps-pre"
    assert (above.get_ylabel(), below.get_ylabel(), levels.get_ylabel()) == (
        "success",
        "episode return",
        "curriculum level",
    )
    assert below.get_xlabel() == "frames"


def test_the_smoothed_curve_weights_iterations_by_their_episodes(drawn: list[Figure]) -> None:
    history = [{"frames": float(i), "success": float(i % 2), "episodes": 1.0 + 2 * (i % 2)} for i in range(24)]
    learning_curve(history, Path("unused.png"))
    smooth = drawn[0].axes[0].lines[1].get_ydata()  # the mean of two neighbours, with weights 1 and 3
    assert smooth == pytest.approx([0.0] + [0.75] * 23)


@pytest.mark.parametrize("history", [[], [{"frames": 10.0, "success": math.nan}], [{"frames": 10.0, "success": 0.5}]])
def test_an_almost_empty_history_is_drawn_without_warnings(history: list[dict[str, float]], tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        learning_curve(history, tmp_path / "curve.png")
    assert [path.name for path in tmp_path.iterdir()] == ["curve.png"]


def test_a_training_of_one_batch_is_a_dot_and_its_level_starts_at_frame_zero(drawn: list[Figure]) -> None:
    learning_curve([{"frames": 10.0, "success": 0.5, "return": 3.0, "level": 1.0}], Path("unused.png"))
    above, below, levels = drawn[0].axes
    for axes in (above, below):
        dot = axes.lines[1]
        assert (dot.get_marker(), dot.get_alpha(), len(dot.get_xdata())) == ("o", None, 1)
    assert levels.lines[0].get_xdata().tolist() == [0, 10] and levels.lines[0].get_ydata().tolist() == [1, 1]


def test_what_has_no_values_is_left_out_of_a_learning_curve(drawn: list[Figure]) -> None:
    history = [{"frames": 100.0 * i, "success": math.nan, "return": math.nan, "level": 1.0} for i in range(1, 4)]
    learning_curve(history, Path("unused.png"))
    above, levels = drawn[0].axes
    assert not above.lines and len(levels.lines) == 1 and above.get_xlabel() == "frames"
    assert [text.get_text() for text in above.texts] == ["no episode has ended yet"]
    assert [text.get_text() for text in drawn[0].legends[0].get_texts()] == ["curriculum level"]
    learning_curve([{**row, "test_success": 0.5} for row in history], Path("unused.png"))
    assert [text.get_text() for text in drawn[1].legends[0].get_texts()] == ["test", "curriculum level"]
    assert len(drawn[1].axes) == 2 and not drawn[1].axes[0].texts


def test_large_returns_are_written_whole_and_not_as_differences_from_an_offset(drawn: list[Figure]) -> None:
    learning_curve([{"frames": 100.0 * n, "return": -123_400.0 - n} for n in range(1, 9)], Path("unused.png"))
    drawn[0].draw_without_rendering()
    axis = drawn[0].axes[1].yaxis
    assert axis.get_offset_text().get_text() == ""
    assert all(label.get_text().startswith("−1234") for label in axis.get_ticklabels())


def test_names_of_scenes_are_shown_as_they_are(drawn: list[Figure]) -> None:
    names = ["cost_$5_or_$6", r"a$\frac{$"]  # between dollars, matplotlib would read mathematics
    scene_bars(names, [0.5, 0.2], [[0.3, 0.7], [0.1, 0.4]], Path("unused.png"))
    drawn[0].draw_without_rendering()
    labels = drawn[0].axes[0].get_yticklabels()
    assert [label.get_text() for label in labels] == names and not any(label.get_parse_math() for label in labels)


def test_bars_of_scenes_have_their_confidence_intervals(drawn: list[Figure]) -> None:
    scene_bars(["worse", "best"], [0.5, 1.0], [[0.2, 0.8], [0.7, 1.0]], Path("unused.png"))
    lines = drawn[0].axes[0].collections[0].get_segments()  # type: ignore[attr-defined]
    assert [[round(float(x), 9) for x in line[:, 0]] for line in lines] == [[0.7, 1.0], [0.2, 0.8]]  # the best is first


def test_letters_are_drawn_in_a_font_that_has_them_or_as_escapes_without_warnings(tmp_path: Path) -> None:
    names = ["Größe, сад", "\N{TOP SQUARE BRACKET}", "\U000f1234 a"]  # the second is in another font of matplotlib's
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene_bars(names, [0.5, 0.3, 0.2], [[0.1, 0.8]] * 3, tmp_path / "bars.png")
    assert [legible(name) for name in names] == [*names[:2], r"\U000f1234 a"]


def test_long_names_leave_room_for_the_bars(drawn: list[Figure]) -> None:
    names = [f"{'a corner of the garden, ' * 8}{number}" for number in range(2)]
    scene_bars(names, [0.5, 0.2], [(0.4, 0.6), (0.1, 0.3)], Path("unused.png"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn[0].draw_without_rendering()
    axes = drawn[0].axes[0]
    assert axes.get_position().width > 0.4
    assert [label.get_text()[-1] for label in axes.get_yticklabels()] == ["0", "1"], "what tells names apart stays"


def test_videos_take_an_installed_font_that_has_the_letters() -> None:
    plain, fallen_back = font(14, "Größe, сад 1"), font(14, "\N{TOP SQUARE BRACKET}")
    assert plain.getname()[0] == OWN_FONT != fallen_back.getname()[0]
    missing = font(14, "\U000f1234").getmask("\U000f1234")
    assert bytes(fallen_back.getmask("\N{TOP SQUARE BRACKET}")) != bytes(missing)


def test_the_suffix_sets_the_file_format(tmp_path: Path) -> None:
    learning_curve([{"frames": 10.0, "success": 0.5}], tmp_path / "curve.pdf")
    assert (tmp_path / "curve.pdf").read_bytes().startswith(b"%PDF")


def test_every_start_is_drawn_as_an_arrow_from_its_position_along_its_heading(drawn: list[Figure]) -> None:
    planar = lattice()
    success = planar[:, 0] > -0.3
    start_map(planar, success, VIEW, Path("unused.png"))
    for color, chosen in ((REACHED, planar[success]), (MISSED, planar[~success])):
        outlines = polygons(drawn[0], color)
        assert len(outlines) == len(chosen)
        way = outlines[:, 3] - chosen[:, :2].numpy()  # the tip
        heading = torch.stack([chosen[:, 2].cos(), chosen[:, 2].sin()], -1).numpy()
        assert way / np.linalg.norm(way, axis=1, keepdims=True) == pytest.approx(heading, abs=1e-5)
        head = outlines[:, 2] - outlines[:, 4]
        assert (head * heading).sum(1) == pytest.approx(0, abs=1e-6) and np.linalg.norm(head, axis=1).min() > 0.02
    assert "72 of 96 start poses (75.0%)" in drawn[0].axes[0].get_title()


@pytest.mark.parametrize("headings", [4, 16, 36])
def test_arrows_at_one_position_and_at_its_neighbours_do_not_overlap(headings: int, drawn: list[Figure]) -> None:
    planar = lattice(headings)
    start_map(planar, torch.ones(len(planar), dtype=torch.bool), VIEW, Path("unused.png"))
    offset = polygons(drawn[0], REACHED) - planar[:, None, :2].numpy()
    cos, sin = np.cos(planar[:, 2:].numpy()), np.sin(planar[:, 2:].numpy())
    along, across = offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin
    assert np.hypot(along, across).max() <= 0.125 + 1e-9  # half the distance to the next position
    assert np.arctan2(np.abs(across), along).max() < math.pi / headings


def test_a_pose_that_succeeds_in_some_episodes_has_its_own_colour(drawn: list[Figure]) -> None:
    planar = lattice().repeat(2, 1)
    success = torch.ones(len(planar), dtype=torch.bool)
    success[:5] = False  # the first of two episodes
    start_map(planar, success, VIEW, Path("unused.png"))
    assert len(polygons(drawn[0], PARTLY)) == 5 and len(polygons(drawn[0], REACHED)) == 91
    assert labels(drawn[0]) == ["goal reached", "reached in some episodes", "goal pose"]


def test_starts_that_are_not_on_a_lattice_get_arrows_of_a_visible_size(drawn: list[Figure]) -> None:
    planar = torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    start_map(planar, planar[:, 0] > 0.5, VIEW, Path("unused.png"))
    arrows = polygons(drawn[0], REACHED)
    length, width = np.linalg.norm(arrows[:, 3] - arrows[:, [0, 6]].mean(1), axis=-1), arrows[:, 2] - arrows[:, 4]
    assert (length > 0.05).all() and (np.linalg.norm(width, axis=-1) > 0.01).all()  # on a map 3 m wide


def test_the_goal_and_the_blocked_positions_are_marked_at_their_positions(drawn: list[Figure]) -> None:
    planar, blocked = lattice(), torch.tensor([[0.5, 0.25], [0.75, 0.5]])
    start_map(planar, planar[:, 0] > 0, VIEW, Path("unused.png"), blocked=blocked)
    crosses, disc = drawn[0].axes[0].lines
    assert np.stack(crosses.get_data(), -1).tolist() == blocked.tolist()
    assert [float(value[0]) for value in disc.get_data()] == [0.3, 0.7]
    (goal,) = polygons(drawn[0], GOAL)
    assert math.atan2(*(goal[3] - PLACE[:2].numpy())[::-1]) == pytest.approx(0.5)
    assert {"body does not fit", "goal pose"} <= set(labels(drawn[0]))


def test_both_maps_mark_the_positions_from_which_no_path_leads_to_the_goal(drawn: list[Figure]) -> None:
    planar, cut_off = lattice(), torch.tensor([[0.5, 0.25], [0.75, 0.5]])
    start_map(planar, planar[:, 0] > 0, VIEW, Path("unused.png"), cut_off=cut_off)
    success_map(planar, planar[:, 0] > 0, VIEW, Path("unused.png"), cut_off=cut_off)
    for figure in drawn:
        dots = figure.axes[0].lines[0]
        assert np.stack(dots.get_data(), -1).tolist() == cut_off.tolist() and dots.get_linestyle() == "None"
        assert "goal cannot be reached" in labels(figure)


def test_the_title_says_how_many_of_the_start_set_were_tried(drawn: list[Figure]) -> None:
    for every in (None, 96, 1000):
        start_map(lattice(), lattice()[:, 0] > -0.3, VIEW, Path("unused.png"), every=every)
    title = "goal reached from 72 of 96 start poses (75.0%)"
    assert [figure.axes[0].get_title() for figure in drawn] == [title, title, f"{title}\n96 of 1,000 tried"]


def test_each_mark_is_drawn_and_marks_with_the_same_name_share_a_legend_entry(drawn: list[Figure]) -> None:
    places = torch.tensor([[0.3, 0.7, math.nan], [-0.5, 0.2, math.nan], [0.9, 1.1, 0.5]], dtype=torch.float64)
    marks = [Mark(name, place) for name, place in zip(("apple", "apple", "door"), places, strict=True)]
    start_map(lattice(), lattice()[:, 0] > 0, replace(VIEW, marks=marks), Path("unused.png"))
    discs = [[float(value[0]) for value in line.get_data()] for line in drawn[0].axes[0].lines]
    assert discs == places[:, :2].tolist()
    looks = [(to_hex(line.get_color()), line.get_marker()) for line in drawn[0].axes[0].lines]
    assert looks[0] == looks[1] and all(apple != door for apple, door in zip(looks[0], looks[2], strict=True))
    assert len(polygons(drawn[0], looks[2][0])) == 1 and not len(polygons(drawn[0], GOAL))  # apples have no direction
    assert labels(drawn[0]) == ["goal reached", "not reached", "apple", "door"]
    shown = [(to_hex(line.get_color()), line.get_marker()) for line in drawn[0].legends[0].get_lines()]
    assert shown == [looks[0], looks[2]]


def test_a_map_without_marks_draws_none(drawn: list[Figure]) -> None:
    success_map(lattice(), torch.ones(96, dtype=torch.bool), MapView(GROUND), Path("unused.png"))
    assert not drawn[0].axes[0].lines and labels(drawn[0]) == []


def test_cells_show_the_mean_over_headings_at_their_position(drawn: list[Figure]) -> None:
    planar = lattice()
    success = torch.rand(len(planar), generator=torch.Generator().manual_seed(1)) > 0.4
    success_map(planar, success, VIEW, Path("unused.png"))
    heat = next(c for c in drawn[0].axes[0].collections if c.get_array() is not None)
    centers = np.array([path.vertices[:-1].mean(0) for path in heat.get_paths()])
    assert centers == pytest.approx(planar[::8, :2].numpy())
    assert np.asarray(heat.get_array()) == pytest.approx(success.view(12, 8).double().mean(1).numpy())
    assert heat.get_clim() == (0, 1)
    assert np.ptp(heat.get_paths()[0].vertices[:, 0]) == pytest.approx(0.86 * 0.25)
    assert drawn[0].axes[0].get_title() == f"success by start position (all starts {success.double().mean():.1%})"


def test_cells_far_apart_are_drawn_small_and_at_their_positions(drawn: list[Figure]) -> None:
    planar = lattice() * torch.tensor([2.8, 2.8, 1.0], dtype=torch.float64)  # 0.7 m apart on a map of 3 m
    success_map(planar, torch.ones(96, dtype=torch.bool), VIEW, Path("unused.png"))
    heat = next(c for c in drawn[0].axes[0].collections if c.get_array() is not None)
    centers = np.array([path.vertices[:-1].mean(0) for path in heat.get_paths()])
    assert centers == pytest.approx(planar[::8, :2].numpy(), abs=1e-6)
    assert np.ptp(heat.get_paths()[0].vertices[:, 0]) == pytest.approx(0.86 * 3.0 / 8)


def test_a_map_is_in_metres_with_x_to_the_right_and_y_up(drawn: list[Figure]) -> None:
    success_map(lattice(), torch.ones(96, dtype=torch.bool), VIEW, Path("unused.png"))
    axes = drawn[0].axes[0]
    assert axes.get_xlim() == (-1.5, 1.5) and axes.get_ylim() == (-0.5, 1.5)
    assert axes.images[0].get_extent() == [-1.5, 1.5, -0.5, 1.5] and axes.images[0].origin == "upper"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")
    width, height = axes.get_position().size * drawn[0].get_size_inches()
    assert width / height == pytest.approx(1.5)


def test_solid_areas_are_outlined_at_their_position(drawn: list[Figure]) -> None:
    solid = torch.zeros(80, 120, dtype=torch.bool)
    solid[20:40, 70:90] = True  # 0.025 m per pixel: x from 0.25 to 0.75, y from 0.5 to 1
    success_map(lattice(), torch.ones(96, dtype=torch.bool), replace(VIEW, solid=solid), Path("unused.png"))
    hatched = next(c for c in drawn[0].axes[0].collections if getattr(c, "hatches", [None])[0])
    outline = hatched.get_paths()[0].vertices
    assert [*outline.min(0), *outline.max(0)] == pytest.approx([0.25, 0.5, 0.75, 1.0], abs=0.002)
    assert "solid at body height" in labels(drawn[0])


def test_a_written_map_has_green_where_the_goal_is_reached_and_red_where_not(tmp_path: Path) -> None:
    planar = lattice(16)
    start_map(planar, planar[:, 0] > -0.1, VIEW, tmp_path / "map.png")
    assert [path.name for path in tmp_path.iterdir()] == ["map.png"]
    pixels = np.asarray(Image.open(tmp_path / "map.png").convert("RGB")).astype(int)[:-90]  # without the legend
    columns = []
    for color in (REACHED, MISSED):
        wanted = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
        near = np.abs(pixels - wanted).max(-1) < 12
        assert near.sum() > 500
        columns.append(near.nonzero()[1])
    assert columns[1].max() < columns[0].min()


def test_starts_that_are_too_dense_to_be_seen_are_thinned_evenly(drawn: list[Figure]) -> None:
    steps = torch.arange(0.0, 1.0, 0.01, dtype=torch.float64)
    starts = torch.cartesian_prod(steps, steps, torch.zeros(1, dtype=torch.float64))
    start_map(starts, torch.ones(len(starts), dtype=torch.bool), VIEW, Path("unused.png"))
    arrows = polygons(drawn[0], REACHED)
    cell = 3.0 / start_maps.MOST_ARROWS  # the map is 3 m wide
    assert len(arrows) == math.ceil(1.0 / cell) ** 2
    assert np.ptp(arrows[:, :, 0], axis=1).min() > 0.4 * cell
    title = drawn[0].axes[0].get_title()
    assert "10,000 of 10,000 start poses" in title and f"\n{len(arrows)} of them drawn" in title


def test_an_inset_shows_the_whole_place_and_the_window_of_the_map(drawn: list[Figure]) -> None:
    wide = TopDown(torch.full((40, 60, 3), 90, dtype=torch.uint8), (-15.0, 15.0, -5.0, 15.0))
    starts, done = lattice(), torch.ones(96, dtype=torch.bool)
    start_map(starts, done, replace(VIEW, overview=wide), Path("unused.png"))
    success_map(starts, done, replace(VIEW, overview=wide), Path("unused.png"))
    for figure in drawn:
        inset = next(axes for axes in figure.axes[0].child_axes if "30 × 20 m" in axes.get_xlabel())
        assert inset.get_xlim() == (-15.0, 15.0) and inset.get_ylim() == (-5.0, 15.0)
        box = inset.patches[-1].get_bbox()
        assert (box.x0, box.x1, box.y0, box.y1) == GROUND.extent
    start_map(starts, done, VIEW, Path("unused.png"))
    assert not drawn[-1].axes[0].child_axes


@pytest.mark.parametrize("sides", [(3.0, 1.0), (1.0, 3.0), (1.0, 1.0)])
def test_what_stands_beside_a_map_has_its_size_whatever_the_shape_of_the_map(
    sides: tuple[float, float], drawn: list[Figure]
) -> None:
    width, height = sides
    ground = TopDown(torch.zeros(round(60 * height), round(60 * width), 3, dtype=torch.uint8), (0, width, 0, height))
    view = MapView(ground, overview=TopDown(torch.zeros(60, 60, 3, dtype=torch.uint8), (-9.0, 9.0, -9.0, 9.0)))
    success_map(lattice(), torch.ones(96, dtype=torch.bool), view, Path("unused.png"))
    drawn[0].draw_without_rendering()
    inset, scale = drawn[0].axes[0].child_axes
    assert scale.bbox.width / drawn[0].dpi == pytest.approx(start_maps.SCALE)
    assert inset.bbox.size / drawn[0].dpi == pytest.approx([start_maps.OVERVIEW] * 2)
    assert not inset.get_tightbbox().overlaps(scale.get_tightbbox())
    assert not inset.get_tightbbox().overlaps(drawn[0].axes[0].title.get_window_extent())
