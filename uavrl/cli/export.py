"""``uavrl-export``: the policy of a run on its own, small enough to give away, and the data set of a run."""

import logging
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

log = logging.getLogger(__name__)


@dataclass
class ExportConfig:
    """conf/export.yaml: one policy on its own, or the data set of one run."""

    packages: tuple[Text, ...] = ()
    run: Folder | None = None
    policy: str | None = None
    checkpoint: Folder | None = None
    guards: Any = None
    output: Folder | None = None
    data: Folder | None = None

    def __post_init__(self) -> None:
        """Checks the guards, and that there is a place to write to."""
        guard_settings(self.guards, GuardSettings.all())
        if self.output is None and self.data is None:
            add = f"output={self.policy}" if self.policy else "output=my_policy, or data=my_data for the data set"
            raise UavrlError(f"output must be a folder to write the policy to, and none is given: add {add}.")
        if self.data is not None and self.run is None:
            raise UavrlError("data= writes the data set of a run, and none is given: add run=RUN_FOLDER.")
        if self.data is not None and self.output is not None and Path(self.data) == Path(self.output):
            raise UavrlError(f"output and data must be two folders, got {self.data} for both.")
        if self.guards is not None and self.output is None:
            raise UavrlError("guards= are those of an exported policy: add output=FOLDER, or leave guards out.")


@command("export")
def main(config: DictConfig) -> None:
    """Writes weights, configuration, contract and model card, which other commands take as ``run=``, or a data set."""
    settings = validate(config, ExportConfig)
    folder = policy_folder(settings.run, settings.policy)
    if folder is None:
        raise unknown_policy(str(settings.policy), packaged_policies(), "to export your own give run=RUN_FOLDER.")
    require_run(folder)
    if settings.output is not None:
        require_free(Path(settings.output))
    log.info("Loading %s ...", settings.run or settings.policy)
    if settings.data is not None:
        _export_data(folder, settings.checkpoint, Path(settings.data), settings.packages)
    if settings.output is not None:
        _export_policy(folder, Path(settings.output), settings)


def _export_data(folder: Path, checkpoint: str | None, data: Path, packages: tuple[str, ...]) -> None:
    # Imported here: --help and a mistyped key answer without loading torch.
    from uavrl.export.data import export_data
    from uavrl.export.recorded import DATA, STORAGE

    about = export_data(folder, checkpoint, data, packages)
    size = f"{pluralize(about['transitions'], 'transition')} of {pluralize(about['episodes'], 'episode')}"
    print(f"Exported {size} to {data}. TorchRL reads {data / STORAGE}; {data / DATA} describes it.")


def _export_policy(folder: Path, output: Path, settings: ExportConfig) -> None:
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
