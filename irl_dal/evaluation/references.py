"""Returns of expert and random actions, remembered so that no evaluation drives them twice."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irl_dal.evaluation.measurements import ReferenceReturns
from irl_dal.evaluation.report import write_json

__all__ = ["ReferenceCache"]

FILE_NAME = "references.json"


@dataclass(frozen=True, slots=True)
class ReferenceCache:
    """A JSON file {city: {driver: {seed: return}}} beside the runs.

    Attributes:
        path: The file; it need not exist.
        city: Hash of everything that the returns depend on.
    """

    path: Path
    city: str

    @classmethod
    def beside(cls, runs: Path, city: str) -> ReferenceCache:
        """The cache in a folder of runs."""
        return cls(runs / FILE_NAME, city)

    def missing(self, driver: str, seeds: Sequence[int]) -> list[int]:
        """Seeds whose return is not known yet."""
        known = self._read().get(self.city, {}).get(driver, {})
        return [seed for seed in seeds if str(seed) not in known]

    def add(self, driver: str, returns: Mapping[int, float]) -> None:
        """Remember returns by seed."""
        content = self._read()
        entry = content.setdefault(self.city, {}).setdefault(driver, {})
        entry.update({str(seed): float(value) for seed, value in returns.items()})
        write_json(self.path, content)

    def returns(self, seeds: Sequence[int]) -> ReferenceReturns:
        """Returns of both drivers on these seeds.

        Raises:
            KeyError: One of them is missing.
        """
        entry = self._read()[self.city]
        known = {name: [entry[name][str(seed)] for seed in seeds] for name in ("expert", "random")}
        return ReferenceReturns(np.array(known["expert"]), np.array(known["random"]))

    def _read(self) -> dict[str, dict[str, dict[str, float]]]:
        """What the file holds: nothing if it is missing or damaged, it is only a cache."""
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return {}
        return dict(content) if isinstance(content, dict) else {}
