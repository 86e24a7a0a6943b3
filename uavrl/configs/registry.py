"""Where the yaml files lie, and how they become checked dataclasses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.configs.schema import GROUPS, EvaluateConfig, TrainConfig
from uavrl.errors import UavrlError


def conf_dir() -> Path:
    """The folder of yaml files: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for candidate in (package / "conf", package.parent / "conf"):
        if (candidate / "config.yaml").is_file():
            return candidate
    raise UavrlError(f"Expected the yaml files in {package / 'conf'} and found none: install uavrl again.")


def register_schemas() -> None:
    """Puts every dataclass into Hydra's ConfigStore; yaml files name theirs as ``<group>/<name>_schema``."""
    store = ConfigStore.instance()
    store.store(name="train_schema", node=TrainConfig)
    store.store(name="evaluate_schema", node=EvaluateConfig)
    for group, schemas in GROUPS.items():
        for name, schema in schemas.items():
            store.store(group=group, name=f"{name}_schema", node=schema)


def to_dataclass(config: DictConfig) -> Any:
    """Resolves a composed configuration and turns it into its dataclass, checking every value.

    Raises:
        UavrlError: naming the key whose value is missing or out of range.
    """
    try:
        return OmegaConf.to_object(config)
    except UavrlError:
        raise
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        raise UavrlError(f"The configuration does not hold together: {str(error).splitlines()[0]}") from error
