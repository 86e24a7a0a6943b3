"""``uavrl-pretrain``: from the states of a run to the trajectory classifier that ABR⁺ loads."""

import logging
from pathlib import Path

from omegaconf import DictConfig

from uavrl.cli.command import command
from uavrl.config import validate
from uavrl.config.command_line import command_line
from uavrl.runs.config import require_typed_run
from uavrl_onboard.pluralize import pluralize

log = logging.getLogger(__name__)


@command("pretrain")
def main(config: DictConfig) -> None:
    """Makes one artifact."""
    require_typed_run(config)
    if config.progress is True:
        log.info("Loading %s ...", config.run)
    # Imported here: --help and a mistyped key answer without loading torch.
    from uavrl.pretraining.pipeline import pretrain
    from uavrl.pretraining.settings import PretrainConfig
    from uavrl.training.matmul import matmul_backend

    settings = validate(config, PretrainConfig)
    with matmul_backend(settings.matmul, settings.threads):
        about = pretrain(settings)
    source, learned, elbow = about["source"], about["classifier"], about["sse"]["elbow"]
    states, episodes = pluralize(source["states"], "state"), pluralize(source["episodes"], "episode")
    print(f"{source['states_drawn']:,} of {states} in {episodes}")
    print(
        pluralize(about["k"], "class", "classes") + (f" (elbow of the SSE curve: {elbow})" if elbow is not None else "")
    )
    print(f"The classifier says the right one for {learned['held_out_accuracy']:.1%} of held-out states")
    print("Class sizes")
    for name, sizes in about["class_sizes"].items():
        spread = f"mean {sizes['mean']:.2f}, largest {sizes['largest']}, SD {sizes['sd']:.2f}"
        print(f"  {name}: {pluralize(sizes['classes'], 'class', 'classes')}, {spread}")
    print(f"Artifact: {about['output']}")
    chosen = {"backward_reward": "abr_plus", "backward_reward.artifact": Path(about["output"])}
    print(f"Train with it, and with that run's perception: {command_line('uavrl-train', **chosen)}")


if __name__ == "__main__":
    main()
