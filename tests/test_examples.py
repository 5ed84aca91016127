"""The examples run. Tests marked ``slow`` need the extra ``slow``; the others need nothing."""

import os
import subprocess
import sys
from importlib import util
from pathlib import Path

import gymnasium
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, *arguments: str) -> str:
    """Run an example, and return what it prints."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "RAY_DEDUP_LOGS": "0"}
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_list_of_examples_matches_the_files() -> None:
    listed = {
        line.split("](")[1].split(")")[0] for line in (EXAMPLES / "README.md").read_text().splitlines() if "| [" in line
    }
    there = {str(path.relative_to(EXAMPLES)) for path in EXAMPLES.rglob("*") if path.suffix in (".py", ".ipynb")}
    assert listed == there


def test_the_envhub_file_makes_a_suite_as_lerobot_steps_it() -> None:
    spec = util.spec_from_file_location("envhub_env", EXAMPLES / "envhub" / "env.py")
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    env = module.make_env(n_envs=2)["splatrl"][0]
    assert isinstance(env, gymnasium.vector.SyncVectorEnv) and env.num_envs == 2  # LeRobot looks into its ``envs``
    seen, _ = env.reset(seed=[0, 1])
    assert (
        seen["pixels"]["front"].shape == (2, 64, 64, 3) and env.call("task_description") == ("drive to the goal",) * 2
    )
    ahead, beyond = [0.5, 0.0], [-9.0, 9.0]  # metres and radians per second; what policies predict may be out of range
    moved, *_ = env.step(np.array([ahead, beyond], np.float32))
    assert np.linalg.norm((moved["agent_pos"] - seen["agent_pos"])[0, :2]) == pytest.approx(0.1)  # in 0.2 s
    for _ in range(env.call("_max_episode_steps")[0]):
        *_, terminated, truncated, info = env.step(np.array([beyond, beyond], np.float32))
        if (terminated | truncated).any():
            break
    assert info["final_info"]["is_success"].dtype == bool
    env.close()


def test_notebooks_are_stored_without_outputs() -> None:
    for path in EXAMPLES.glob("*.ipynb"):
        assert '"output_type"' not in path.read_text()


@pytest.mark.slow
def test_ppo_in_one_file_learns_to_reach_near_goals() -> None:
    lines = run("cleanrl_ppo.py", "--frames", "6144", "--robots", "16", "--steps", "16").splitlines()
    assert len(lines) == 24
    first, last = (float(lines[row].split("success ")[1].split()[0]) for row in (2, -1))
    assert last > first + 0.1


@pytest.mark.slow
def test_ppo_in_one_file_rounds_frames_up_to_whole_updates() -> None:
    lines = run("cleanrl_ppo.py", "--frames", "40", "--robots", "4", "--steps", "8").splitlines()
    assert [line.split()[0] for line in lines] == ["32", "64"]


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["direct", "process", "ray"])
def test_the_collector_runs_with_each_backend(backend: str) -> None:
    lines = [line for line in run("collectors.py", backend, "--frames", "320").splitlines() if line.startswith(backend)]
    assert len(lines) == 2 and all("160 frames of" in line for line in lines)


@pytest.mark.slow
def test_rllib_trains() -> None:
    assert "1: mean return" in run("rllib_ppo.py", "--iterations", "1", "--runners", "0", "--batch", "256")


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.name)
def test_a_notebook_runs_and_shows_pictures(path: Path) -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(path.parent)}}).execute()
    pictures = [out for cell in notebook.cells for out in cell.get("outputs", []) if "image/png" in out.get("data", {})]
    assert len(pictures) >= 2


@pytest.mark.slow
@pytest.mark.parametrize(("launcher", "target"), [("ray", "RayLauncher"), ("submitit_slurm", "SlurmLauncher")])
def test_a_preset_chooses_its_launcher(launcher: str, target: str, tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "splatrl.commands.train",
        f"+launcher={launcher}",
        "--cfg",
        "hydra",
        "-p",
        "hydra.launcher",
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.returncode == 0 and target in done.stdout, done.stderr


@pytest.mark.slow
def test_a_sweep_runs_on_a_local_cluster_of_ray(tmp_path: Path) -> None:
    tiny = ["collector.total_frames=1024", "evaluation.starts=8", "logger.num_test_episodes=8", "logger.video=false"]
    command = [sys.executable, "-m", "splatrl.commands.train", "-m", "seed=0,1", "+launcher=ray", "device=cpu", *tiny]
    subprocess.run([*command, f"hydra.sweep.dir={tmp_path}/sweep"], check=True, cwd=tmp_path, timeout=600)
    assert all((tmp_path / "sweep" / job / "evaluation.json").is_file() for job in "01")
