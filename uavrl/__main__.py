"""``python -m uavrl COMMAND …`` is ``uavrl COMMAND …``."""

from uavrl.cli.main import main

if __name__ == "__main__":
    main()
