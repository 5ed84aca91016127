"""Edits change single values of a scene.yaml and keep the rest."""

from pathlib import Path

import pytest

from splatrl.scenes.description import read_description
from splatrl.scenes.editing import edit_description

TEXT = """\
# mine
splat: "room.ply"  # the splat
bounds: [[0, 0, 0], [4, 3, 2]]
goal: [0.5, 1.0, 0.0]  # looks at the red thing
object:
  - 0.75
  - 1.0
  - 0.5
walk:
- [0, 0]
- [1, 1]
quality:  # of the capture
  psnr: 30.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(TEXT)
    return tmp_path


def test_a_value_is_changed_in_place(folder: Path) -> None:
    edit_description(folder, {"goal": [0.25, -1.0, 90.0], "walk": [[0.0, 0.0], [2.0, 2.5]]})
    expected = TEXT.replace("[0.5, 1.0, 0.0]", "[0.25, -1.0, 90.0]")
    expected = expected.replace("walk:\n- [0, 0]\n- [1, 1]\n", "walk: [[0.0, 0.0], [2.0, 2.5]]\n")
    assert (folder / "scene.yaml").read_text() == expected


def test_a_block_value_becomes_one_line_and_new_keys_come_last(folder: Path) -> None:
    edit_description(folder, {"object": [1.0, 2.0, 0.5], "robot_height": 0.4})
    text = (folder / "scene.yaml").read_text()
    assert "\nobject: [1.0, 2.0, 0.5]\nwalk:\n" in text
    assert text.endswith("  psnr: 30.0\nrobot_height: 0.4  # height of the robot's camera, metres\n")
    assert read_description(folder)["quality"] == {"psnr": 30.0}


def refused(stated: object) -> None:
    raise ValueError("task.goal: expected a point in the walkable area")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"goal": [1.0, 2.0]}, r"goal: expected \[x, y, yaw\]"),
        ({"walk": [[0, 0], [0, 1]]}, "walk: expected"),
        ({"bounds": [[0, 0, 0], [4, -3, 2]]}, "bounds: expected lower below upper along y"),
        ({"goal": [float("nan"), 0.0, 0.0]}, "goal: expected"),
    ],
)
def test_values_that_the_reader_would_refuse_are_not_written(
    folder: Path, changed: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        edit_description(folder, changed)
    assert (folder / "scene.yaml").read_text() == TEXT


def test_a_check_sees_the_whole_description_and_can_refuse_the_edit(folder: Path) -> None:
    seen: list[object] = []
    edit_description(folder, {"goal": [0.0, 0.0, 0.0]}, seen.append)
    assert seen == [read_description(folder)]
    before = (folder / "scene.yaml").read_text()
    with pytest.raises(ValueError, match="in the walkable area"):
        edit_description(folder, {"goal": [9.0, 9.0, 0.0]}, refused)
    assert (folder / "scene.yaml").read_text() == before
    assert [path.name for path in folder.iterdir()] == ["scene.yaml"]


def test_a_file_without_one_line_per_key_is_left_unchanged(folder: Path) -> None:
    text = '{splat: "room.ply", goal: [0, 0, 0]}\n'
    (folder / "scene.yaml").write_text(text)
    with pytest.raises(ValueError, match="expected one line per key"):
        edit_description(folder, {"goal": [1.0, 0.0, 0.0]})
    assert (folder / "scene.yaml").read_text() == text


def test_comments_within_a_block_are_kept(folder: Path) -> None:
    commented = TEXT.replace("- 0.75\n", "- 0.75  # from the door\n  # measured\n")
    (folder / "scene.yaml").write_text(commented)
    edit_description(folder, {"object": [1.0, 2.0, 0.5]})
    expected = "object: [1.0, 2.0, 0.5]\n  # from the door\n  # measured\nwalk:\n"
    assert expected in (folder / "scene.yaml").read_text()
    edit_description(folder, {"object": [1.0, 2.0, 0.75]})
    assert expected.replace("0.5]", "0.75]") in (folder / "scene.yaml").read_text()


def test_line_endings_permissions_and_links_are_kept(folder: Path) -> None:
    real, link = folder / "shared.yaml", folder / "scene.yaml"
    link.unlink()
    link.symlink_to(real)
    real.write_bytes(TEXT.replace("\n", "\r\n").encode())
    real.chmod(0o620)
    edit_description(folder, {"goal": [0.25, -1.0, 90.0]})
    assert link.is_symlink() and real.stat().st_mode & 0o777 == 0o620
    assert real.read_bytes() == TEXT.replace("[0.5, 1.0, 0.0]", "[0.25, -1.0, 90.0]").replace("\n", "\r\n").encode()


def test_a_read_only_file_is_not_replaced(folder: Path) -> None:
    (folder / "scene.yaml").chmod(0o444)
    with pytest.raises(PermissionError, match=r"read-only.*scene.yaml"):
        edit_description(folder, {"goal": [1.0, 0.0, 0.0]})
    assert (folder / "scene.yaml").read_text() == TEXT
