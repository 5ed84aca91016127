"""The policy head: a distribution over actions that fits the action spec."""

from tensordict.nn import (
    InteractionType,
    NormalParamExtractor,
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor, nn
from torch.distributions import Distribution
from torchrl.data import Bounded, Categorical, TensorSpec
from torchrl.modules import TanhNormal

from splatrl.training.distributions import Choice, Squashed

FIRST_GAIN = 0.01
"""Orthogonal-initialisation gain of the last layer: small, so that the first policy hardly depends on the image."""
FIRST_SCALE = 0.6
"""Initial standard deviation before the tanh, which spreads actions over most of their range."""
LEAST_SCALE = 0.01
"""Lower bound on the standard deviation: below it PPO's ratios become unstable."""


def orthogonal(layer: nn.Linear | nn.Conv2d, gain: float) -> nn.Linear | nn.Conv2d:
    """Initialise a layer in place with orthogonal weights of this gain and a bias of zero."""
    assert layer.bias is not None
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.constant_(layer.bias, 0.0)
    return layer


class Leading(nn.Module):
    """Keeps the first features of its input, and drops the rest.

    Args:
        features: number of features to keep.
    """

    def __init__(self, features: int):
        super().__init__()
        self.features = features

    def forward(self, hidden: Tensor) -> Tensor:
        """[..., F] -> [..., features]."""
        return hidden[..., : self.features]


def policy_head(
    action_spec: TensorSpec, features: int, beside: bool = False, spread: float = FIRST_SCALE
) -> ProbabilisticTensorDictSequential:
    """Make the head that maps ``hidden`` to ``action`` and ``action_log_prob``.

    Args:
        action_spec: spec of an env's action, batched or not. ``Categorical`` gives a categorical distribution.
            ``Bounded`` floats in the last axis give a normal one, squashed by a tanh to the limits of the spec, whose
            mean and standard deviation depend on ``hidden``.
        features: size of ``hidden``, or of the part of it that is read.
        beside: whether ``hidden`` holds more after that part, which the policy does not read.
        spread: initial standard deviation of continuous actions before the tanh.

    Raises:
        ValueError: for any other spec.
    """
    layer: nn.Module
    kind: type[Distribution]
    options: dict[str, Tensor]
    if isinstance(action_spec, Categorical):
        layer = orthogonal(nn.Linear(features, action_spec.space.n), FIRST_GAIN)
        parameters, kind, options = ["logits"], Choice, {}
    elif isinstance(action_spec, Bounded) and action_spec.dtype.is_floating_point and action_spec.ndim:
        linear = orthogonal(nn.Linear(features, 2 * action_spec.shape[-1]), FIRST_GAIN)
        layer = nn.Sequential(linear, NormalParamExtractor(f"biased_softplus_{spread}", LEAST_SCALE))
        limits = {"low": action_spec.space.low, "high": action_spec.space.high}
        parameters, kind = ["loc", "scale"], Squashed
        options = {name: limit.reshape(-1, limit.shape[-1])[0] for name, limit in limits.items()}
    else:
        raise ValueError(f"action_spec: expected a Categorical spec or a Bounded spec of floats, got {action_spec}")
    layer = nn.Sequential(Leading(features), layer) if beside else layer
    return ProbabilisticTensorDictSequential(
        TensorDictModule(layer, in_keys=["hidden"], out_keys=parameters),
        ProbabilisticTensorDictModule(
            in_keys=parameters,
            out_keys=["action"],
            distribution_class=kind,
            distribution_kwargs=options,
            default_interaction_type=InteractionType.RANDOM,  # TorchRL's default is the mode, also in env.rollout
            return_log_prob=True,
            log_prob_key="action_log_prob",
        ),
    )


def distribution(head: ProbabilisticTensorDictSequential, hidden: Tensor) -> Distribution:
    """Return the distribution of actions for ``hidden``, [..., features] float32, without using TensorDicts."""
    layer, sampler = head.module
    parameters = layer.module(hidden)
    parameters = parameters if isinstance(parameters, tuple) else (parameters,)
    named = dict(zip(sampler.in_keys, parameters, strict=True))
    return sampler.distribution_class(**named, **sampler.distribution_kwargs)


def entropy(policy: Distribution) -> Tensor:
    """Return the entropy of each distribution in a batch, [...].

    If it has no closed form, the result is an estimate from one sample, which is differentiable.
    """
    if isinstance(policy, TanhNormal):
        return -policy.rsample_and_log_prob()[1]
    return policy.entropy()
