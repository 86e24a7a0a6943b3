"""TorchRL's loggers, chosen by the configuration."""

from __future__ import annotations

import os
import re
from pathlib import Path

from torchrl.record.loggers import Logger, TensorboardLogger, get_logger

from uavrl.configs.train import LoggerConfig
from uavrl.errors import UavrlError
from uavrl.files import replacing

_ROW = re.compile(r"\d+,\S+\n")  # step and value


def make_logger(config: LoggerConfig, run_dir: Path) -> Logger:
    """Makes the logger; its files go below ``run_dir/logs``.

    Raises:
        UavrlError: when the logger's package is not installed.
    """
    kwargs = {}
    if config.name == "wandb":
        os.environ.setdefault("WANDB_SILENT", "true")
        kwargs = {"wandb_kwargs": {"project": config.project, "mode": "offline" if config.offline else "online"}}
    package = {"csv": "", "tensorboard": "tensorboard", "wandb": "wandb"}[config.name]
    try:
        return get_logger(config.name, logger_name=str(run_dir / "logs"), experiment_name=run_dir.name, **kwargs)
    except ImportError as error:
        raise UavrlError(
            f"logger={config.name} needs the package {package}: run pip install 'uavrl[{package}]'."
        ) from error


def cut_back(logger: Logger, run_dir: Path, steps: int) -> None:
    """Drops what was logged after this number of steps, by a process that was killed or stopped.

    Whoever goes on from a checkpoint logs the steps after it again. wandb shows them twice, in two of its runs.
    """
    if isinstance(logger, TensorboardLogger):
        logger.experiment.close()
        logger.experiment.purge_step = steps + 1  # the next value opens a file that begins with it
    _cut_back_csv(run_dir, steps)


def _cut_back_csv(run_dir: Path, steps: int) -> None:
    """Rewrites the CSV logger's files; one that is not the logger's is left alone."""
    for path in (run_dir / "logs").glob("*/scalars/*.csv"):
        rows = path.read_text().splitlines(keepends=True)
        whole = [row for row in rows if row.endswith("\n")]
        if not all(_ROW.fullmatch(row) for row in whole):
            continue
        kept = [row for row in whole if int(row.partition(",")[0]) <= steps]
        if len(kept) < len(rows):
            with replacing(path) as partial:
                partial.write_text("".join(kept))
