"""Damaged files of every format are read, or refused with a ValueError that names the file, and cause nothing else."""

from pathlib import Path

import pytest

from tests.fuzzing.formats import FORMATS
from tests.fuzzing.trials import try_files

NEEDS = {"compressed ply": "gsply", "sog": "gsply", "unpacked sog": "gsply", "spz 4": "imagecodecs"}
NEEDS |= {"lzfse": "imagecodecs", "r3d": "imagecodecs", "robot": "mujoco", "stl": "mujoco", "obj": "mujoco"}


@pytest.mark.parametrize(("count", "seed"), [(60, 0), pytest.param(20_000, 1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_file_is_read_or_refused_by_name(name: str, count: int, seed: int, tmp_path: Path) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason="needs an extra")
    found = try_files(FORMATS[name], count, seed, tmp_path)
    assert not found.faults and found.tried == count
