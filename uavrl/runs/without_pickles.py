"""TorchRL's adapter for state dicts, told not to unpickle."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tensordict
from torchrl.checkpoint import StateDictCheckpointAdapter

from uavrl.upstream import decode_state_dict


class StateDictWithoutPickles(StateDictCheckpointAdapter):
    """Reads the one payload that uavrl writes, a folder, and refuses a pickle in it.

    TorchRL's own reads three others where it finds them, and leaves out tensordict's ``allow_pickle=False``.
    """

    def load(
        self,
        component: Any,
        path: Path,
        *,
        map_location: Any,
        tensor_load_kwargs: Mapping[str, Any],
        args: tuple[Any, ...],
        kwargs: Mapping[str, Any],
    ) -> None:
        """Restores ``component`` from ``path``."""
        tensors = tensordict.load(path / self.state_directory, allow_pickle=False)
        schema = json.loads((path / self.schema_filename).read_text(encoding="utf-8"))
        component.load_state_dict(decode_state_dict(schema, tensors, map_location), *args, **kwargs)
