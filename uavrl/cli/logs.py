"""The library's log, and what PyTorch and TorchRL add to it."""

import logging
import os

from uavrl_onboard.cli import process


def configure_logging() -> None:
    """Sends the library's log to standard error, in short lines; call it before TorchRL is imported."""
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
    os.environ.setdefault("RL_WARNINGS", "False")
    process.configure_logging()
    logging.getLogger("torch").setLevel(logging.WARNING)  # if it is interrupted while it loads, it tells of its caches
    logging.getLogger("torch.utils.cpp_extension").setLevel(logging.ERROR)  # a CUDA compiler without a GPU is no news
    for name in logging.root.manager.loggerDict:
        if name.startswith(("uavrl", "__main__")):  # a module that python -m runs is __main__
            logging.getLogger(name).disabled = False  # Hydra silences those that are there before it
