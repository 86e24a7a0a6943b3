"""``uavrl``: all commands by one name; ``uavrl train …`` is ``uavrl-train …``."""

import sys
from importlib import import_module

from uavrl import __version__
from uavrl.cli.compare import ABOUT as COMPARE
from uavrl.cli.help import ABOUT
from uavrl.errors import UavrlError
from uavrl_onboard.cli.check import ABOUT as CHECK
from uavrl_onboard.cli.fly import ABOUT as FLY
from uavrl_onboard.cli.process import command_process
from uavrl_onboard.cli.scan import ABOUT as SCAN
from uavrl_onboard.sentences import did_you_mean

COMMANDS = {about.name.removeprefix("uavrl-"): about.summary for about in (*ABOUT.values(), COMPARE, SCAN, CHECK, FLY)}
ON_BOARD = ("scan", "check", "fly")  # commands of uavrl-onboard


def main() -> None:
    """Runs the command that is named first."""
    with command_process():
        _run(*(sys.argv[1:] or ["--help"]))


def _run(name: str, *rest: str) -> None:
    if name in ("--version", "-V"):
        print(f"uavrl {__version__}")
    elif name in ("--help", "-h", "help"):
        print("uavrl: trains a quadrotor to fly to a goal through a cluttered valley with a LiDAR.\n")
        print("\n".join(f"  uavrl {command:<10}{summary}" for command, summary in COMMANDS.items()))
        print("\nuavrl COMMAND --help explains a command. To watch a trained policy: uavrl replay policy=best")
    else:
        if name not in COMMANDS:
            told = did_you_mean(name, list(COMMANDS), ": ", "uavrl --help lists them.")
            raise UavrlError(f"There is no command {name!r}{told}")
        sys.argv = [f"uavrl-{name}", *rest]
        import_module(f"{'uavrl_onboard' if name in ON_BOARD else 'uavrl'}.cli.{name}").main()


if __name__ == "__main__":
    main()
