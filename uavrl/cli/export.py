"""``uavrl-export``: the policy of a run on its own, small enough to give away."""

from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from uavrl.cli.command import command
from uavrl.command_line import command_line
from uavrl.config import validate
from uavrl.config.sentences import did_you_mean, require
from uavrl.errors import UavrlError
from uavrl.ranges import Folder, Text
from uavrl.rollout.policies import packaged_policies, policy_folder


@dataclass
class ExportConfig:
    """conf/export.yaml: one policy on its own."""

    packages: tuple[Text, ...] = ()
    run: Folder | None = None
    policy: str | None = None
    checkpoint: Folder | None = None
    output: Folder | None = None

    def __post_init__(self) -> None:
        """Checks that there is a place to write to."""
        require(self.output is not None, "output", "a folder to write the policy to", self.output)


@command("export")
def main(config: DictConfig) -> None:
    """Writes weights and configuration; evaluation and replay take the folder as ``run=``."""
    _export(validate(config, ExportConfig))


def _export(settings: ExportConfig) -> None:
    folder, output = policy_folder(settings.run, settings.policy), Path(str(settings.output))
    if folder is None:
        names = packaged_policies()
        near = did_you_mean(str(settings.policy), names, ": ", "to export your own give run=RUN_FOLDER.")
        raise UavrlError(f"policy must be one of {', '.join(names)}, got {settings.policy!r}{near}")
    # Imported here: --help and a mistyped key answer without loading torch.
    from uavrl.rollout.saved import POLICY_INFO, export_policy, load_actor

    config, actor, known = load_actor(folder, settings.checkpoint, "cpu", settings.packages)
    about = {key: known[key] for key in ("run", *POLICY_INFO) if key in known}
    export_policy(actor, config, {"run": folder.resolve().name, **about}, output)
    steps = f"{about['training_steps']:,}" if "training_steps" in about else "its"
    then = command_line("uavrl-evaluate", run=output)
    print(f"The policy after {steps} steps is in {output}. See how well it flies: {then}")


if __name__ == "__main__":
    main()
