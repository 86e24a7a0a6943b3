"""``uavrl-export``: the policy of a run on its own, small enough to give away."""

import argparse
from pathlib import Path

from uavrl.cli.process import command_process
from uavrl.command_line import command_line
from uavrl.errors import UavrlError
from uavrl.runs.weights import POLICY


def main() -> None:
    """Writes weights and configuration; evaluation and replay take the folder as ``run=``."""
    parser = argparse.ArgumentParser(
        prog="uavrl-export",
        description="Writes the policy of a run, with its configuration and without optimisers and replay buffer, to a "
        "folder that uavrl-evaluate and uavrl-replay take as run=FOLDER.",
    )
    parser.add_argument("run", type=Path, metavar="RUN_FOLDER", help="a run that uavrl-train made")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="where the policy goes")
    parser.add_argument("--checkpoint", default=None, metavar="FILE", help="a checkpoint (default: the run's newest)")
    parser.add_argument(
        "--packages", nargs="*", default=[], metavar="PACKAGE", help="packages whose classes the run may name"
    )
    with command_process():
        _export(parser.parse_args())


def _export(args: argparse.Namespace) -> None:
    # Imported here: --help answers without loading torch.
    from uavrl.training.policies import export_policy, load_actor

    if POLICY.is_in(args.run):
        raise UavrlError(f"{args.run} holds a policy on its own already: copy the folder.")
    config, actor, about = load_actor(args.run, args.checkpoint, "cpu", args.packages)
    export_policy(actor, config, {**about, "run": args.run.resolve().name}, args.output)
    steps = f"{about['training_steps']:,}" if "training_steps" in about else "its"
    evaluate = command_line("uavrl-evaluate", run=args.output)
    print(f"The policy after {steps} steps is in {args.output}. See how well it flies: {evaluate}")


if __name__ == "__main__":
    main()
