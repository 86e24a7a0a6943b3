"""TorchRL's loggers, chosen by the configuration."""

import importlib
import os
import re
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torchrl.record.loggers import CSVLogger, Logger, TensorboardLogger, WandbLogger

from uavrl.config.build import build, find_class
from uavrl.config.parts import Part
from uavrl.errors import UavrlError
from uavrl.runs.names import LOGS
from uavrl_onboard.files import replacing

WANDB_SILENT = ("WANDB_SILENT", "true")
_ROW = re.compile(r"\d+,\S+\n")  # step and value


def make_logger(part: Part, run_dir: Path, name: str, choice: str, packages: Iterable[str] = ()) -> Logger | None:
    """Makes the logger, which the user chose by ``logger=CHOICE``; its files go below ``run_dir/logs``.

    ``name`` is what the run is called there, which does not change when its folder is renamed.
    """
    with _wandb_errors(choice):
        return build(part, Logger, packages=packages, exp_name=name, log_dir=str(run_dir / LOGS))


def require_login(part: Part, packages: Iterable[str] = ()) -> None:
    """Asks for the login that wandb's online runs need, before anything is made for the run."""
    if part.get("offline", True) or part._target_ is None:
        return
    if issubclass(find_class(str(part._target_), Logger, packages), OneRunWandbLogger):
        os.environ.setdefault(*WANDB_SILENT)
        with _wandb_errors("wandb"):
            importlib.import_module("wandb").login(verify=False)


@contextmanager
def _wandb_errors(choice: str) -> Iterator[None]:
    """Turns what wandb raises, and a missing package, into a sentence."""
    try:
        yield
    except Exception as error:
        if type(error).__module__.partition(".")[0] == "wandb":
            reason = next(iter(str(error).splitlines()), type(error).__name__).rstrip(".")
            raise UavrlError(
                f"logger=wandb could not begin ({reason}): log in with wandb login, or keep logger.offline=true."
            ) from error
        if not isinstance(error, ImportError):
            raise
        package = (error.name or choice).partition(".")[0]
        raise UavrlError(f"logger={choice} needs the package {package}: run pip install 'uavrl[{package}]'.") from error


class OneRunWandbLogger(WandbLogger):
    """Logs to one run of wandb, however often a process is killed and another one resumes the training.

    wandb's own process writes with a delay of up to some 15 s, and what it holds is lost when the training is killed.
    So each value is also written to a CSV file, at once, and a process that resumes sends all values again: its run has
    the id of the one before, and replaces it.
    """

    def __init__(self, project: str = "uavrl", offline: bool = True, *, exp_name: str, log_dir: str) -> None:
        os.environ.setdefault(*WANDB_SILENT)
        name = Path(log_dir) / "wandb_run_id"
        name.parent.mkdir(parents=True, exist_ok=True)
        if not name.exists():
            with replacing(name) as partial:
                partial.write_text(uuid.uuid4().hex[:8], encoding="utf-8")
        own = {"id": name.read_text(encoding="utf-8"), "mode": "offline" if offline else "online"}
        super().__init__(exp_name=exp_name, log_dir=log_dir, project=project, **own)
        self._values = CSVLogger(exp_name=exp_name, log_dir=log_dir)

    def log_scalar(self, name: str, value: float, step: int | None = None, *args: Any, **kwargs: Any) -> None:
        """Logs a value, and keeps it for a process that resumes."""
        if step is not None:
            self._values.log_scalar(name, value, step)
        super().log_scalar(name, value, step, *args, **kwargs)

    def send_again(self) -> None:
        """Sends what is kept, and removes the offline runs of earlier processes, which this one replaces."""
        rows = (
            (step, path.stem, value)
            for path in Path(self._values.experiment.log_dir).glob("scalars/*.csv")
            for step, value in _rows(path)
        )
        for step, name, value in sorted(rows):
            super().log_scalar(name, value, step)
        own = Path(self.experiment.dir).parent.name
        for folder in Path(self.log_dir).glob("wandb/offline-run-*"):
            if folder.name != own and not folder.is_symlink():
                shutil.rmtree(folder, ignore_errors=True)


class IntervalLog:
    """Hands values to a logger, each once in so many steps."""

    def __init__(self, logger: Logger | None, interval: int) -> None:
        self.logger = logger
        self.interval = interval
        self._logged_at: dict[str, int] = {}

    def add(self, values: Mapping[str, Any], step: int) -> None:
        """Logs what has not been logged for long."""
        for name, value in values.items():
            if step - self._logged_at.get(name, 0) > self.interval:
                self._logged_at[name] = step
                if self.logger is not None:
                    self.logger.log_scalar(name, float(value), step=step)

    def flush(self) -> None:
        """Has TensorBoard write what it holds back: a checkpoint follows, after which it would not be logged again."""
        if isinstance(self.logger, TensorboardLogger):
            self.logger.experiment.flush()

    def state_dict(self) -> dict[str, Any]:
        """The steps at which each name was last logged."""
        return {"logged_at": self._logged_at}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._logged_at = dict(state_dict["logged_at"])


def close(logger: Logger | None) -> None:
    """Ends wandb's run, so that the next training in this process gets its own."""
    if isinstance(logger, OneRunWandbLogger):
        logger.experiment.finish()


def truncate_logs(logger: Logger | None, run_dir: Path, steps: int) -> None:
    """Drops what was logged after a checkpoint's steps: it is logged again."""
    for path in (run_dir / LOGS).glob("*/scalars/*.csv"):
        _truncate(path, steps)
    if isinstance(logger, OneRunWandbLogger):
        logger.send_again()
    if isinstance(logger, TensorboardLogger):
        logger.experiment.close()
        logger.experiment.purge_step = steps + 1  # the next value opens a file that begins with it


def _truncate(path: Path, steps: int) -> None:
    rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
    whole = [row for row in rows if row.endswith("\n")]
    if not all(_ROW.fullmatch(row) for row in whole):
        return  # it is not the CSV logger's
    kept = [row for row in whole if int(row.partition(",")[0]) <= steps]
    if len(kept) < len(rows):
        with replacing(path) as partial:
            partial.write_text("".join(kept), encoding="utf-8")


def _rows(path: Path) -> Iterator[tuple[int, float]]:
    """Steps and values of a file of the CSV logger."""
    for row in path.read_text(encoding="utf-8").splitlines(keepends=True):
        if _ROW.fullmatch(row):
            step, _, value = row.partition(",")
            yield int(step), float(value)
