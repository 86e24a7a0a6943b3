"""Losses whose critics normalise their batches."""

from __future__ import annotations

from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, actor, stochastic_actor
from uavrl.losses import ActorCriticLoss, CrossQLoss, CrossQTD3Loss, XQCLoss, XQCTD3Loss
from uavrl.models import BatchRenormCritic, CategoricalCritic

KEYS = ["observation", "action"], ["state_action_value"]


def renormalised(warmup: int = 10_000) -> list[TensorDictModule]:
    return [TensorDictModule(BatchRenormCritic(6, 2, (8,), warmup=warmup), *KEYS) for _ in range(2)]


def categorical() -> list[TensorDictModule]:
    return [TensorDictModule(CategoricalCritic(6, 2, (8, 8), atoms=21), *KEYS) for _ in range(2)]


def crossq(warmup: int = 10_000, **options: object) -> CrossQLoss:
    return CrossQLoss(stochastic_actor(), renormalised(warmup), action_spec=SPEC, **options)


def crossq_td3(warmup: int = 10_000, **options: object) -> CrossQTD3Loss:
    return CrossQTD3Loss(actor(), renormalised(warmup), action_spec=SPEC, **options)


def xqc(**options: object) -> XQCLoss:
    return XQCLoss(stochastic_actor(), categorical(), action_spec=SPEC, **options)


def xqc_td3(**options: object) -> XQCTD3Loss:
    return XQCTD3Loss(actor(), categorical(), action_spec=SPEC, **options)


def batch(size: int = 12) -> TensorDict:
    return ActorCriticLossContract().make_data(size=size)


def statistics(loss: ActorCriticLoss) -> list[Tensor]:
    """Copies of those of the critics, and of their targets."""
    found = loss.state_dict().items()
    names = ("running_mean", "running_var", "batches")
    return [value.clone() for key, value in found if key.rpartition(".")[2] in names]
