"""``uavrl-export``: the policy of a run on its own, small enough to give away."""

from pathlib import Path

from omegaconf import DictConfig

from uavrl.cli.command import command
from uavrl.command_line import command_line
from uavrl.configs import checked
from uavrl.configs.checks import did_you_mean
from uavrl.configs.export import ExportConfig
from uavrl.errors import UavrlError
from uavrl.rollout.policies import packaged_policies, policy_folder


@command("export")
def main(config: DictConfig) -> None:
    """Writes weights and configuration; evaluation and replay take the folder as ``run=``."""
    _export(checked(config, ExportConfig))


def _export(settings: ExportConfig) -> None:
    folder, output = policy_folder(settings.run, settings.policy), Path(str(settings.output))
    if folder is None:
        names = packaged_policies()
        near = did_you_mean(str(settings.policy), names, ": ", "to export your own give run=RUN_FOLDER.")
        raise UavrlError(f"policy must be one of {', '.join(names)}, got {settings.policy!r}{near}")
    # Imported here: --help and a mistyped key answer without loading torch.
    from uavrl.rollout.saved import TOLD, export_policy, load_actor

    config, actor, known = load_actor(folder, settings.checkpoint, "cpu", settings.packages)
    about = {key: known[key] for key in ("run", *TOLD) if key in known}
    export_policy(actor, config, {"run": folder.resolve().name, **about}, output)
    steps = f"{about['training_steps']:,}" if "training_steps" in about else "its"
    then = command_line("uavrl-evaluate", run=output)
    print(f"The policy after {steps} steps is in {output}. See how well it flies: {then}")


if __name__ == "__main__":
    main()
