"""Captured gradient steps, with a tape in place of a CUDA graph."""

import copy
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDictBase

from splatrl.training.learner import Learner
from splatrl.training.memory import Memory
from tests.tiny import tiny_env
from tests.training.tape import Taped
from tests.training.test_memory import MEMORY, remembering
from tests.training.test_ppo import LOSS, OPTIM, learner

BATCHES = 4


@pytest.fixture(scope="module", params=[0, MEMORY], ids=["without memory", "with memory"])
def batches(request: pytest.FixtureRequest) -> tuple[Learner, list[TensorDictBase]]:
    """A learner that has learned nothing, and batches whose last minibatch is smaller than the others."""
    ppo = learner(remembering(tiny_env([8], max_steps=5), request.param), memory=request.param)
    for part in ppo.model.modules():
        if isinstance(part, Memory):
            part.stepwise = True  # as on a GPU
    return ppo.learner, [ppo.collect().clone() for _ in range(BATCHES)]


def test_captured_steps_equal_steps_one_by_one_also_after_a_checkpoint(
    batches: tuple[Learner, list[TensorDictBase]],
) -> None:
    found, (origin, collected) = [], batches
    size = 3 * collected[0].shape[1] if origin._memory else 12
    loss = replace(LOSS, mini_batch_size=size, entropy_coeff=0.5, anneal_entropy=True)
    optim = replace(OPTIM, anneal_lr=True)
    for capture in (None, Taped):
        model = copy.deepcopy(origin.model)
        made = Learner(model, loss, optim, capture)
        torch.manual_seed(5)
        reports = []
        for number, batch in enumerate(collected):
            made.anneal(1.0 - number / BATCHES)
            reports.append(made.learn(batch.clone()))
            if number == 1:
                made.load_optimizer(copy.deepcopy(made.optimizer.state_dict()))
        weights = torch.cat([value.detach().flatten() for value in model.parameters()])
        found.append((reports, weights))
    for one_by_one, captured in zip(found[0][0], found[1][0], strict=True):
        assert captured == pytest.approx(one_by_one, rel=1e-4, abs=1e-6)  # a captured learning rate has 32 bits
    torch.testing.assert_close(found[1][1], found[0][1], atol=1e-6, rtol=1e-5)
    before = torch.cat([value.detach().flatten() for value in origin.parameters])
    assert (found[0][1] - before).abs().max() > 1e-3
