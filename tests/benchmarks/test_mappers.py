"""benchmarks/mappers.py compares two maps of a video with the ground truth; the video and the maps are faked here."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from splatrl.capture.sfm.job import Job
from splatrl.capture.truth import Truth

pytest.importorskip("pycolmap")
pytest.importorskip("av")

COUNT, WRONG = 60, 0.5
SECONDS = np.arange(COUNT) / 4.0
PLACES = np.stack([SECONDS, np.sin(SECONDS), 0 * SECONDS], 1)


def test_a_row_gives_the_number_of_images_the_jerks_and_the_errors_of_a_map(
    benchmark: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mappers = benchmark("mappers")
    poses = torch.eye(4).double().repeat(COUNT, 1, 1)
    poses[:, :3, 3] = torch.from_numpy(PLACES)
    film = tmp_path / "yard 7" / "walk.mp4"
    job = Job("", [f"{number:04}.jpg" for number in range(COUNT)], 8, 6, seconds=SECONDS.tolist())
    torn = 2.0 * PLACES  # the scale of a map is arbitrary
    torn[30] += [0.0, 0.0, 2.0 * WRONG]
    maps: dict[str, Any] = {
        "map_one_by_one": (np.arange(COUNT), torn),
        "map_at_once": (np.arange(5, COUNT), 3.0 * PLACES[5:]),
        "find_cameras": (np.arange(2), PLACES[:2]),
    }
    for name, found in maps.items():
        monkeypatch.setattr(mappers, name, lambda *_, found=found: found)
    monkeypatch.setattr(mappers, "pycolmap", SimpleNamespace(logging=SimpleNamespace()))  # leaves its log alone
    monkeypatch.setattr(mappers, "camera_places", lambda model, _: model)
    monkeypatch.setattr(mappers, "least_carried", lambda *_: 0.25)
    monkeypatch.setattr(mappers, "match_images", lambda *_: None)
    monkeypatch.setattr(mappers, "read_photos", lambda *_: None)
    monkeypatch.setattr(mappers, "job_of", lambda *_: job)
    monkeypatch.setattr(mappers, "filmed", lambda path, options: [path][options.along])
    monkeypatch.setattr(mappers, "read_truth", lambda _: Truth(poses, torch.from_numpy(SECONDS), torch.eye(3)))
    monkeypatch.setattr(mappers, "measured_machine", lambda: None)
    monkeypatch.setattr(sys, "argv", ["mappers.py", "--yards", "7", "--keep", str(tmp_path)])
    mappers.main()
    one, once, taken = mappers.mapped("yard 7", film, tmp_path / "again", 0)
    assert (one.film, one.posed, one.images, once.posed, taken.posed) == ("yard 7", COUNT, COUNT, COUNT - 5, 2)
    assert one.jerks > 4.0 > once.jerks and one.carried == 0.25
    assert once.scales == pytest.approx(1.0) and one.scales > 1.02
    assert 0.9 * WRONG < one.worst_metres < WRONG and 0.9 * WRONG < one.ate_metres * COUNT**0.5 < WRONG
    assert once.worst_metres < 1e-9 and np.isnan(taken.worst_metres)
    rows = [[cell.strip() for cell in line.split("|")] for line in capsys.readouterr().out.splitlines()]
    assert ["", "yard 7", "at once", f"{COUNT - 5} of {COUNT}"] in [row[:4] for row in rows]
