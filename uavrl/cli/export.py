"""``uavrl-export``: the policy of a run on its own, small enough to give away."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from uavrl.cli.command import command
from uavrl.config import validate
from uavrl.config.command_line import command_line
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import default_guards, packaged_policies, policy_folder, unknown_policy
from uavrl.runs.config import require_run
from uavrl.runs.weights import require_free
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.policy.contract import CONTRACT
from uavrl_onboard.ranges import Folder, Text


@dataclass
class ExportConfig:
    """conf/export.yaml: one policy on its own."""

    packages: tuple[Text, ...] = ()
    run: Folder | None = None
    policy: str | None = None
    checkpoint: Folder | None = None
    guards: Any = None
    output: Folder | None = None

    def __post_init__(self) -> None:
        """Checks the guards, and that there is a place to write to."""
        guard_settings(self.guards, GuardSettings.all())
        if self.output is None:
            name = self.policy or "my_policy"
            raise UavrlError(f"output must be a folder to write the policy to, and none is given: add output={name}.")


@command("export")
def main(config: DictConfig) -> None:
    """Writes weights, configuration, contract and model card; evaluation and replay take the folder as ``run=``."""
    settings = validate(config, ExportConfig)
    folder, output = policy_folder(settings.run, settings.policy), Path(str(settings.output))
    if folder is None:
        raise unknown_policy(str(settings.policy), packaged_policies(), "to export your own give run=RUN_FOLDER.")
    require_run(folder)
    require_free(output)
    # Imported here: --help, a mistyped key and a wrong folder answer without loading torch.
    from uavrl.export.export import export_policy
    from uavrl.export.model_card import CARD

    guards = guard_settings(settings.guards, default_guards(folder))
    about = export_policy(folder, settings.checkpoint, output, settings.packages, guards=guards)
    trained = f" ({pluralize(about['training_steps'], 'training step')})" if "training_steps" in about else ""
    then = command_line("uavrl-evaluate", run=output)
    print(f"Exported the policy{trained} to {output}. Its model card is {output / CARD}.")
    if (output / CONTRACT).is_file():
        print(f"{output / CONTRACT} describes its inputs and outputs for other programs.")
    print(f"To measure its success rate: {then}")


if __name__ == "__main__":
    main()
