"""Every private name of TorchRL, tensordict, torch and Ray that uavrl uses: where it can break when they move.

Functions are given a public name here and imported from here. What a class inherits, or an object is asked for, cannot
be imported: it stands in :data:`ATTRIBUTES`. ``tests/test_upstream.py`` tells what a new version has moved, and what is
used and missing here.
"""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.fx import GraphModule
from torchrl.checkpoint._checkpoint import _decode_state_dict_value as decode_state_dict

__all__ = [
    "ATTRIBUTES",
    "add",
    "compile_graph",
    "decode_state_dict",
    "fused_adam",
    "lerp",
    "ray_job",
    "rows",
]

fused_adam = torch._fused_adam_
lerp = torch._foreach_lerp_
add = torch._foreach_add_


def compile_graph(graph: GraphModule, inputs: list[Any], **options: Any) -> Callable[..., Any]:
    """A graph as Inductor's machine code. ``torch.compile`` adds guards, which cost more than a small update."""
    import torch._inductor  # takes seconds

    return torch._inductor.compile(graph, inputs, options=options)


def rows(storage: TensorDictBase, index: Tensor) -> TensorDictBase:
    """The rows ``index [B]`` of all tensors, without the checks of the public ``apply``."""
    return storage._fast_apply(lambda stored: stored.index_select(0, index), batch_size=[len(index)])


def ray_job(folders: list[str]) -> Any:
    """A job of Ray whose workers import from ``folders``, and not from the driver's working folder, as they would."""
    from ray.job_config import JobConfig

    job = JobConfig(_py_driver_sys_path=folders)
    job._runtime_env_has_working_dir = lambda: True  # type: ignore[method-assign]
    return job


# By the class that has them. TorchRL's documentation tells subclasses of the first three to write such methods.
ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "torchrl.envs.EnvBase": ("_reset", "_step", "_set_seed"),
    "torchrl.envs.transforms.Transform": ("_reset", "_step", "_call", "_inv_call", "_apply_transform"),
    "torchrl.objectives.LossModule": (
        "_AcceptedKeys",
        "_forward_value_estimator_keys",
        "_reduce_loss",
        "_maybe_get_priority_weight",
        "_has_update_associated",
    ),
    "torchrl.objectives.DDPGLoss": ("_set_in_keys",),
    "torchrl.objectives.TD3Loss": ("_make_vmap", "_vmap_qvalue_network00"),
    "torchrl.objectives.SACLoss": (
        "_make_vmap",
        "_vmap_qnetworkN0",
        "_compute_target_v2",
        "_alpha",
        "_alpha_loss",
    ),
    "torchrl.objectives.SoftUpdate": ("_sources", "_targets"),
    "torchrl.data.LazyTensorStorage": ("_storage", "_empty"),
    "torchrl.data.TensorDictRoundRobinWriter": ("_cursor",),
    "torchrl.collectors.Collector": ("_weight_sync_schemes", "_frames", "_iter"),
    "tensordict.TensorDict": ("_fast_apply",),
    "tensordict.nn.TensorDictModule": ("_kwargs",),
    "torch.nn.Module": ("_modules", "_load_from_state_dict"),
}
