"""One env with TorchRL's Collector: python examples/collectors.py direct, process or ray

``ray`` needs ``pip install ray``; it starts a cluster on this machine, or joins the one at RAY_ADDRESS.
"""

import argparse
import os

from torchrl.collectors import Collector

import splatrl


def main() -> None:
    """Collect frames with random actions, from two workers with eight robots each (only the first for ``direct``)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("backend", choices=("direct", "process", "ray"))
    parser.add_argument("--frames", type=int, default=640)
    options = parser.parse_args()
    makers = splatrl.env_makers(2, ["scene=backyard", "task=grid"], batch_size=[8], seed=0)
    settings = None
    if options.backend == "ray":
        cluster = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": 2, "include_dashboard": False}
        settings = {"ray_init_config": cluster, "remote_configs": {"num_cpus": 1, "num_gpus": 0}}
    collector = Collector(
        makers[0] if options.backend == "direct" else makers,
        None,  # random actions; put your policy here
        backend=options.backend,
        backend_options=settings,
        frames_per_batch=160,
        total_frames=options.frames,
    )
    for batch in collector:
        reward = batch["next", "reward"].mean().item()
        print(f"{options.backend}: {batch.numel()} frames of shape {list(batch.batch_size)}, mean reward {reward:.2f}")
    collector.shutdown()


if __name__ == "__main__":
    main()
