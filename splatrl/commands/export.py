"""``splatrl-export``: export the policy of a run as an ONNX file, with a script that runs it without splatrl."""

from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig

from splatrl.commands.entries import export as main
from splatrl.commands.faults import in_one_line
from splatrl.configuration import check_config, conf_dir, config_elsewhere
from splatrl.export import export_policy
from splatrl.export.onnx_file import POLICY, RUNNER, runner
from splatrl.runs import load_policy
from splatrl.values import require_number

KEPT = "kept as it was, changed by you or from another version of splatrl; remove it to get the one of this version"


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="export")
@in_one_line("splatrl-export")
def run(cfg: DictConfig) -> None:
    """Export the policy of the run folder ``cfg.run``."""
    check_config(cfg)
    require_number("frames", cfg.frames, 1, 10**7, whole=True)
    folder = Path(cfg.run)
    out = _chosen_folder(Path(cfg.out)) if cfg.out else folder / "export"
    own = config_elsewhere(folder, cfg.place, cfg.allow_targets)
    torch.set_num_threads(own.threads)
    trained = load_policy(folder, cfg.checkpoint, "cpu", own, place=cfg.place)
    facts = {"task": own.task._target_, "scene": trained.world.name, "run": folder.absolute().name}
    kept = (out / RUNNER).is_file() and (out / RUNNER).read_bytes() != runner()
    found = export_policy(trained.model, trained.world, out, cfg.frames, facts)
    print(f"{out / POLICY}: outputs differ from PyTorch by at most {found:.1e} on {cfg.frames:,} views")
    print(f"{out / RUNNER}: {KEPT if kept else 'runs the policy on a video or a camera'}")


def _chosen_folder(out: Path) -> Path:
    """Return the folder that was typed for an export.

    Raises:
        ValueError: if it holds a policy, which may be that of another run.
    """
    if out.is_file():
        raise ValueError(f"out: expected a folder, got {out}, a file")
    if (out / POLICY).exists():
        raise ValueError(f"out: expected a folder without {POLICY}, got {out}, which holds one")
    return out


if __name__ == "__main__":
    main()
