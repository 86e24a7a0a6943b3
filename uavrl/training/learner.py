"""Builds the policy and its loss, with enhancers, from a configuration."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torchrl.modules import ProbabilisticActor, TanhNormal

from uavrl.configs.algo import DDPGConfig, ForkConfig, LifeGuardConfig, SACConfig, TD3Config
from uavrl.losses import ActorCriticLoss, DDPGLoss, Fork, LifeGuard, SACLoss, TD3Loss
from uavrl.models import Actor, Critic, GaussianActor, RewardNet, SystemNet
from uavrl.training.spaces import Spaces


def make_actor(algo: DDPGConfig, spaces: Spaces, device: torch.device | str = "cpu") -> TensorDictModuleBase:
    """The policy: reads ``observation``, writes ``action``; SAC's samples it, the others' is deterministic."""
    if not isinstance(algo, SACConfig):
        actor = Actor(spaces.state, spaces.actions, algo.hidden, limit=spaces.limit).to(device)
        return TensorDictModule(actor, in_keys=["observation"], out_keys=["action"])
    gaussian = GaussianActor(spaces.state, spaces.actions, algo.hidden).to(device)
    return ProbabilisticActor(
        TensorDictModule(gaussian, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=spaces.action_spec(device),
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -spaces.limit, "high": spaces.limit},
        return_log_prob=True,
    )


def make_loss(algo: DDPGConfig, actor: TensorDictModuleBase, spaces: Spaces, device: torch.device) -> ActorCriticLoss:
    """The loss module of the algorithm with critics of its own, FORK around it and LifeGuard around both."""
    spec = spaces.action_spec(device)
    critics = [_critic(spaces, algo, device) for _ in range(1 if type(algo) is DDPGConfig else 2)]
    loss: ActorCriticLoss
    if isinstance(algo, TD3Config):
        loss = TD3Loss(
            actor,
            critics,
            action_spec=spec,
            gamma=algo.gamma,
            policy_noise=algo.policy_noise,
            noise_clip=algo.noise_clip,
        )
    elif isinstance(algo, SACConfig):
        entropy = "auto" if algo.target_entropy is None else algo.target_entropy
        loss = SACLoss(actor, critics, action_spec=spec, gamma=algo.gamma, target_entropy=entropy)
    else:
        loss = DDPGLoss(actor, critics[0], gamma=algo.gamma)
    if algo.fork is not None:
        loss = _with_fork(loss, algo.fork, algo.gamma, spaces)
    if algo.lifeguard is not None:
        loss = _with_lifeguard(loss, algo.lifeguard, spaces)
    return loss.to(device)


def _critic(spaces: Spaces, algo: DDPGConfig, device: torch.device) -> TensorDictModule:
    net = Critic(spaces.state, spaces.actions, algo.hidden, layer_norm=algo.layer_norm).to(device)
    return TensorDictModule(net, in_keys=["observation", "action"], out_keys=["state_action_value"])


def _with_fork(loss: ActorCriticLoss, config: ForkConfig, gamma: float, spaces: Spaces) -> Fork:
    width, actions = spaces.state, spaces.actions
    predicts_rewards = config.variant == "fork"
    return Fork(
        loss,
        system_network=SystemNet(width, actions, config.system_hidden),
        reward_network=RewardNet(width, actions, config.reward_hidden) if predicts_rewards else None,
        observations=width,
        variant=config.variant,  # type: ignore[arg-type]
        max_reward=config.max_reward,
        gamma=gamma,
        base_weight=config.base_weight,
        threshold=config.threshold,
        return_window=config.return_window,
        backprop_through_model=config.backprop_through_model,
    )


def _with_lifeguard(loss: ActorCriticLoss, config: LifeGuardConfig, spaces: Spaces) -> LifeGuard:
    return LifeGuard(
        loss,
        observations=spaces.observation,
        actions=spaces.actions,
        model=config.model,  # type: ignore[arg-type]
        penalty=config.penalty,  # type: ignore[arg-type]
        penalty_weight=config.penalty_weight,
        success_window=config.success_window,
        capacity=config.capacity,
        batch_size=config.batch_size,
        min_collisions=config.min_collisions,
        min_evaluations=config.min_evaluations,
        evaluation_window=config.evaluation_window,
        min_true_negative_rate=config.min_true_negative_rate,
        model_lr=config.model_lr,
        alpha=config.alpha,
    )
