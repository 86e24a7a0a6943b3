"""``uavrl``: all commands by one name; ``uavrl train …`` is ``uavrl-train …``."""

import sys
from importlib import import_module

from uavrl.cli.process import command_process
from uavrl.config.sentences import did_you_mean
from uavrl.errors import UavrlError

COMMANDS = {
    "train": "trains one policy, or one for each combination of values",
    "evaluate": "flies fixed tasks and tells how often a policy solves them",
    "replay": "writes a page that plays flights back",
    "report": "compares runs in one page",
    "export": "writes a run's policy to a folder of its own",
    "pretrain": "learns the trajectory classifier of ABR⁺ from a run",
}


def main() -> None:
    """Runs the command that is named first."""
    with command_process():
        _run(*(sys.argv[1:] or ["--help"]))


def _run(name: str, *rest: str) -> None:
    if name in ("--version", "-V"):
        from importlib.metadata import version

        print(f"uavrl {version('uavrl')}")
    elif name in ("--help", "-h", "help"):
        print("uavrl: teaches a quadrotor to fly to a goal through a cluttered valley, seeing only by LiDAR.\n")
        print("\n".join(f"  uavrl {command:<10}{about}" for command, about in COMMANDS.items()))
        print("\nuavrl COMMAND --help tells more. To see a trained policy fly: uavrl replay policy=static")
    else:
        if name not in COMMANDS:
            told = did_you_mean(name, list(COMMANDS), ": ", "uavrl --help lists them.")
            raise UavrlError(f"There is no command {name!r}{told}")
        sys.argv = [f"uavrl-{name}", *rest]
        import_module(f"uavrl.cli.{name}").main()


if __name__ == "__main__":
    main()
