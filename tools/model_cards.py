"""Writes the model cards of the packaged policies, ``uavrl/policies/data/NAME/README.md``.

    python -m tools.model_cards

A card is made of the other files in the folder: the weights' origin, the configuration, the contract, ``suite.json``
and ``card.yaml``, which holds the license, the training command, and sentences about use and limits.
"""

from __future__ import annotations

from uavrl.evaluation.policies import PACKAGED, packaged_policies
from uavrl.export.model_card import write_card


def main() -> None:
    """Writes all of them."""
    for name in packaged_policies():
        print(write_card(PACKAGED / name, name))


if __name__ == "__main__":
    main()
