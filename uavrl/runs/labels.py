"""What a run is called in a report and in an evaluation, by the choices of its configuration."""

from collections.abc import Mapping
from functools import cache

from uavrl.config.yaml_files import NONE, compose

# Names of choices in a label; another choice, somebody's own perhaps, goes by the name of its yaml.
_NAMES = {
    "fork": {"on": "FORK"},
    "lifeguard": {"linear": "LG", "mlp": "LG (MLP)"},
    "backward_reward": {"abr": "ABR", "abr_plus": "ABR⁺"},
    "recurrent": {"gru": "GRU"},
    "reward": {
        "traditional": "TR",
        "navigation": "Eq. 3.6",
        "navigation_printed": "Eq. 3.6 as printed",
        "navigation_prize": "prize",
    },
}
_AROUND = ("recurrent", "fork", "lifeguard", "actor_penalty", "smoothness")
_PRESETS = {"dagger": "DAgger", "td3_bc": "TD3-BC"}  # those that stand for a method
_OF_A_METHOD = ("algo", *_AROUND, "cloning", "backward_reward", "reward")


def label(choices: Mapping[str, str]) -> str:
    """The name of a method: its preset and what differs from it, or its learner, its backward reward and its reward.

    Args:
        choices: the yaml file of each part, by the part's name.

    Examples:
        >>> label({"algo": "td3", "lifeguard": "linear", "backward_reward": "abr_plus", "reward": "navigation"})
        'TD3-LG + ABR⁺, Eq. 3.6'
    """
    preset = choices.get("preset", NONE)
    if preset in _PRESETS:
        usual = _of_preset(preset)
        own = [key for key in _OF_A_METHOD if choices.get(key, NONE) != usual.get(key, NONE)]
        return ", ".join([_PRESETS[preset], *(f"{key}={choices.get(key, NONE)}" for key in own)])

    def named(group: str) -> list[str]:
        choice = choices.get(group, NONE)
        return [] if choice == NONE else [_NAMES.get(group, {}).get(choice, choice)]

    around = [name for group in _AROUND for name in named(group)]
    learner = "-".join([choices["algo"].upper(), *around])
    return ", ".join([" + ".join([learner, *named("backward_reward")]), *named("reward")])


@cache
def _of_preset(preset: str) -> dict[str, str]:
    """The choices of a preset as it is."""
    return {str(key): str(value) for key, value in compose(f"preset={preset}").choices.items()}
