"""``python -m uavrl COMMAND …`` is ``uavrl COMMAND …``."""

import sys

try:
    from uavrl.cli.main import main
except ModuleNotFoundError as error:
    if (error.name or "uavrl").partition(".")[0] == "uavrl":
        raise
    sys.exit(
        f"uavrl needs the package {error.name!r}, which {sys.executable} does not have: activate the environment that "
        "uavrl was installed into, in a clone with source .venv/bin/activate."
    )

if __name__ == "__main__":
    main()
