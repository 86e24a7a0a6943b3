"""Writes what a policy reads, number by number, as its contract has it; docs/policies.md shows that of `best`.

python docs/figures/inputs_table.py uavrl/policies/data/best/contract.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uavrl.errors import UavrlError


def table(contract: Path) -> str:
    """A sentence on the state, and a row in Markdown for each quantity of an observation."""
    try:
        terms = json.loads(contract.read_text(encoding="utf-8"))
        state, size = terms["state"], sum(entry["size"] for entry in terms["observation"])
        frames, first = state["frames"], f"{state['padding']:g}"
        sentence = (
            f"{state['size']} numbers ({state['dtype']}), {terms['rate_hz']:g} times per second. They are {frames} "
            f"observations of {size} numbers each, {state['order']}: the numbers {state['size'] - size} to "
            f"{state['size'] - 1} are the present observation. Observations before the first are {first}."
        )
        rows = list(_rows(terms))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UavrlError(f"Expected a contract.json, as uavrl-export writes it, in {contract}: {error!r}.") from error
    return "\n".join([sentence, "", "| numbers of an observation | quantity | scaling |", "|---|---|---|", *rows, ""])


def _rows(terms: dict[str, Any]) -> Iterator[str]:
    begin = 0
    for entry in terms["observation"]:
        last = begin + entry["size"] - 1
        numbers = f"{begin}" if last == begin else f"{begin}–{last}"
        yield f"| {numbers} | {_meaning(entry['name'], terms)} | {_scaled(entry, terms)} |"
        begin = last + 1


def _meaning(name: str, terms: dict[str, Any]) -> str:
    if name == "cells":
        return _cells(terms["cells"])
    if name == "moving_objects":
        motion = terms["motion"]
        return f"the nearest {motion['objects']} moving objects, each {', '.join(motion['object'])}; {motion['frame']}"
    action = terms["action"]
    units = ", ".join(f"{key} ({unit})" for key, unit in zip(action["order"], action["unit"], strict=True))
    return f"{name.replace('_', ' ')}{f', {units}' if name == 'last_action' else ''}; {terms['pose'][name]}"


def _cells(cells: dict[str, Any]) -> str:
    where = f"{cells['count']} directions around the sensor (`cells.directions`)"
    if "columns" in cells:
        borders = " and ".join(f"{border:g}" for border in cells["row_borders"])
        where = (
            f"{cells['count']} cells: {cells['columns']} columns of {cells['width']:g}°, the first one straight ahead, "
            f"the next ones to its left. Each column has {cells['rows']} rows, the lowest first, with borders at "
            f"{borders}°"
        )
    near = cells["statistic"] == "proximity"
    told = f"{cells['radius']:g} m minus {cells['length']}" if near else cells["length"]
    return f"{where}. A cell is {told}, for the nearest point in it, and 0 if it is empty"


def _scaled(entry: dict[str, Any], terms: dict[str, Any]) -> str:
    if isinstance(entry["divisor"], list):
        each = entry["divisor"][: len(terms["motion"]["object"])]
        return f"each object's values / {', '.join(f'{divisor:g}' for divisor in each)}"
    shift, offset = (f" {'-' if entry[key] < 0 else '+'} {abs(entry[key]):g}" for key in ("shift", "offset"))
    value = f"(value{shift}) mod {entry['modulo']:g}" if entry["modulo"] else "value"
    value = f"({value})" if entry["modulo"] else value
    return f"{value} / {entry['divisor']:g}" + (offset if entry["offset"] else "")


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("contract", type=Path, metavar="CONTRACT.json")
    print(table(parser.parse_args().contract), end="")


if __name__ == "__main__":
    main()
