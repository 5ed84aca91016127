"""``splatrl-gait``: write the policy of a ``task=strides`` run as a gait, with which ``task=walk`` walks."""

import argparse

from splatrl.commands.entries import gait as main
from splatrl.commands.faults import in_one_line
from splatrl.export.gait import gait_of
from splatrl.runs import load_policy


@in_one_line("splatrl-gait")
def run(options: argparse.Namespace) -> None:
    """Write the policy of a run folder as a gait."""
    output = options.out or options.run / "gait.npz"
    gait_of(load_policy(options.run, options.checkpoint, "cpu").model).save(output)
    print(output)


if __name__ == "__main__":
    main()
