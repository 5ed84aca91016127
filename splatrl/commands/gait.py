"""``splatrl-gait``: write the policy of a run of ``task=strides`` as a gait, by which ``task=walk`` walks."""

import argparse
from pathlib import Path

from splatrl.commands.faults import in_one_line
from splatrl.export.gait import gait_of
from splatrl.runs import load_policy

EPILOG = """
splatrl-gait outputs/2026-01-31/12-00-00 --out gait.npz
splatrl-train task=walk task.motion.gait=gait.npz
"""


@in_one_line("splatrl-gait")
def run(options: argparse.Namespace) -> None:
    """Write the gait of a run folder."""
    output = options.out or options.run / "gait.npz"
    gait_of(load_policy(options.run, options.checkpoint, "cpu").model).save(output)
    print(output)


def parser() -> argparse.ArgumentParser:
    """The arguments of the command."""
    result = argparse.ArgumentParser(
        "splatrl-gait",
        description="Write the policy of a run of task=strides as a gait, a small file of weights.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("run", type=Path, help="the run folder")
    result.add_argument("--out", type=Path, help="file to write; gait.npz in the run folder unless told")
    result.add_argument("--checkpoint", choices=("last", "best"), default="last", help="of the run (last)")
    return result


def main() -> None:
    """Entry point of the command."""
    run(parser().parse_args())


if __name__ == "__main__":
    main()
