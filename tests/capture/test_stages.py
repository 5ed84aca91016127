"""What a stage keeps is used again until what it depends on changes; nothing that it did not write is removed."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from splatrl.capture.base import CaptureError
from splatrl.capture.stages import STAMP, Stages, fingerprint
from splatrl.files import remove_stale


def noting(calls: list[Path], text: str = "made") -> Callable[[Path], None]:
    """Return a function that writes two files to a folder and notes that it was called."""

    def write(made: Path) -> None:
        calls.append(made)
        (made / "a.txt").write_text(text)
        (made / "in").mkdir()
        (made / "in" / "b.txt").write_text(text)

    return write


def test_a_fingerprint_depends_on_settings_values_shapes_names_and_contents(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a", "b")]
    for path in files:
        path.write_text("same")
    zeros = torch.zeros(2, 3)
    keys = [
        fingerprint([1]),
        fingerprint([2]),
        fingerprint([1], [zeros]),
        fingerprint([1], [zeros.T]),
        fingerprint([1], [zeros.int()]),
        fingerprint([1], files=files[:1]),
        fingerprint([1], files=files[1:]),
        fingerprint([1], files=files),
    ]
    files[0].write_text("other")
    keys.append(fingerprint([1], files=files))
    assert len(set(keys)) == len(keys) and fingerprint([1], [zeros]) == fingerprint([1], [zeros.clone()])
    assert fingerprint({"a": (1, 2), "b": 3}) == fingerprint({"b": 3, "a": [1, 2]})


def test_a_result_is_written_once_per_fingerprint(tmp_path: Path) -> None:
    calls: list[Path] = []
    stages = Stages(tmp_path / "new" / "stages")
    for key, text in (("one", "x"), ("one", "ignored"), ("two", "y"), ("one", "z")):
        path = stages.folder("frames", key, noting(calls, text))
    assert len(calls) == 3 and path == stages.place / "frames"
    assert (path / "a.txt").read_text() == (path / "in" / "b.txt").read_text() == "z"
    assert [each.name for each in stages.place.iterdir()] == ["frames"]


def test_tensors_are_kept_with_their_types(tmp_path: Path) -> None:
    found = {"mask": torch.tensor([[True], [False]]), "depth": torch.rand(3, 2), "count": torch.tensor(4)}
    for find in (lambda: found, lambda: pytest.fail("it is kept")):
        kept = Stages(tmp_path).arrays("depths", "one", find)
        assert all(torch.equal(kept[name], found[name]) and kept[name].dtype == found[name].dtype for name in found)


@pytest.mark.parametrize("how", ["missing", "cut", "changed"])
def test_a_damaged_result_is_repeated_with_a_line_that_names_the_file(tmp_path: Path, how: str) -> None:
    calls: list[Path] = []
    said: list[str] = []
    stages = Stages(tmp_path, said.append)
    path = stages.folder("shots", "one", noting(calls)) / "in" / "b.txt"
    path.unlink() if how == "missing" else path.write_text({"cut": "ma", "changed": "edam"}[how])
    stages.folder("shots", "one", noting(calls))
    assert len(calls) == 2 and path.read_text() == "made"
    assert len(said) == 1 and said[0].startswith(f"{path}: expected the file that was kept")


@pytest.mark.parametrize("stamp", ["", "[]", "{", '{"key": "one", "files": null}'])
def test_a_result_with_a_damaged_stamp_is_repeated(tmp_path: Path, stamp: str) -> None:
    calls: list[Path] = []
    path = Stages(tmp_path).folder("shots", "one", noting(calls))
    (path / STAMP).write_text(stamp)
    Stages(tmp_path).folder("shots", "one", noting(calls))
    assert len(calls) == 2 and json.loads((path / STAMP).read_text())["key"] == "one"


def test_an_interrupted_stage_leaves_nothing_and_is_repeated(tmp_path: Path) -> None:
    calls: list[Path] = []

    def stop(made: Path) -> None:
        (made / "a.txt").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Stages(tmp_path).folder("frames", "one", stop)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / ".frames.0123abcd.tmp" / "in").mkdir(parents=True)  # a kill leaves this
    remove_stale(tmp_path)
    Stages(tmp_path).folder("frames", "one", noting(calls))
    assert [each.name for each in tmp_path.iterdir()] == ["frames"]


def test_files_that_no_stage_wrote_are_never_removed(tmp_path: Path) -> None:
    calls: list[Path] = []
    stages = Stages(tmp_path)
    (tmp_path / "frames").mkdir()
    (tmp_path / "depths").touch()
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / STAMP).write_text("{}")
    (tmp_path / "shots").symlink_to("kept")
    for name in ("frames", "depths", "shots"):
        said = rf"{name}: expected nothing .*, found other files"
        with pytest.raises(CaptureError, match=said):
            stages.folder(name, "one", noting(calls))
        with pytest.raises(CaptureError, match=said):
            stages.workplace(name, "one")
    moving = stages.folder("moving", "one", noting(calls))
    (moving / "in" / "mine.txt").write_text("dear")
    (moving / ".DS_Store").touch()
    assert stages.folder("moving", "one", noting(calls)) == moving, "they do not disturb"
    with pytest.raises(CaptureError, match=r"in/mine\.txt: expected nothing .*, found other files"):
        stages.folder("moving", "two", noting(calls))
    assert (moving / "in" / "mine.txt").read_text() == "dear" and (moving / "a.txt").exists()
    (moving / "in" / "mine.txt").unlink()
    stages.folder("moving", "two", noting(calls))
    assert len(calls) == 2


def test_work_continues_where_it_was_interrupted_and_starts_over_for_another_fingerprint(tmp_path: Path) -> None:
    stages = Stages(tmp_path / "new")
    work = stages.workplace("structure", "one")
    (work / "sparse").mkdir()
    (work / "sparse" / "half").write_text("done")
    assert (stages.workplace("structure", "one") / "sparse" / "half").read_text() == "done"
    assert [each.name for each in stages.workplace("structure", "two").iterdir()] == [STAMP]
    stages.discard("structure")
    stages.discard("structure")
    assert list(stages.place.iterdir()) == []
