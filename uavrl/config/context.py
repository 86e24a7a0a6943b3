"""What a run itself hands to the constructors of its parts, by name.

A class takes of it what its constructor names. Nobody can write these names in a configuration: what the run would
use in place of the written value is refused, so that no ``config.yaml`` records a value that was not used.
"""

from collections.abc import Collection, Iterable, Mapping

from uavrl.errors import UavrlError

_NETWORK = ("observations", "actions", "limit", "stacked")
_PENALTY = ("base", "gamma", *_NETWORK)
# By the part's name; what each name means stands in docs/own_parts.md.
CONTEXT: Mapping[str, tuple[str, ...]] = {
    "env": ("seed", "measure_clearance", "privileged", "tasks"),
    "perception": ("sensor_position",),
    "algo": ("actor_network", "qvalue_network", "num_qvalue_nets", "value_network", "action_spec"),
    "recurrent": ("observations",),
    "fork": _PENALTY,
    "lifeguard": _PENALTY,
    "actor_penalty": _PENALTY,
    "smoothness": _PENALTY,
    "cloning": ("loss", "limit", "execution"),
    "validation": ("new_flier", "policy", "seed"),
    "buffer": ("frames", "seed", "transform"),
    "backward_reward": ("stacked", "observations", "perception", "kept"),
    "collector": (
        *("create_env_fn", "policy", "frames_per_batch", "total_frames", "init_random_frames", "trajs_per_batch"),
        *("traj_format", "policy_device", "env_device", "storing_device", "num_threads"),
        "auto_register_policy_transforms",
    ),
    "logger": ("exp_name", "log_dir"),
    "policy": ("flight_level",),
}


def context_of(key: str) -> tuple[str, ...]:
    """The names that a run hands to the part at a key: ``buffer``, ``algo.critic``."""
    group, _, below = key.partition(".")
    names = CONTEXT.get(group, ())
    if not below:
        return names
    return _NETWORK if group == "algo" else tuple(to_networks(names))


def to_networks(names: Iterable[str]) -> list[str]:
    """Those names that a part hands on to the parts inside of it, which are networks."""
    return [name for name in names if name in _NETWORK]


def refuse_context(key: str, written: Iterable[str], context: Collection[str]) -> None:
    """Refuses a written name that the run hands to the part itself."""
    for name in written:
        if name in context:
            raise UavrlError(f"{key}.{name} is set by the run itself: leave it out.")
