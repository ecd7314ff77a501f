"""All for one short round, then the best few to the end ("Is One Epoch All You Need", 2023)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from search.designs import next_sobol
from search.quality.budget import CostModel, spent
from search.record import Candidate, Record
from search.settings import setting
from search.strategy import Strategy


@dataclass(frozen=True, slots=True)
class TopKSettings:
    """Settings of `top_k`."""

    cost_budget: float | None = setting(None, "total cost, in the unit of the observations' costs", low=0)
    z: float = setting(0.2, "difficulty of the short round", low=0, high=1)
    share: float = setting(0.5, "share of the budget for the short round", low=0, high=1)
    group: int = setting(16, "without a budget: short rounds in a row", low=1)
    k: int = setting(4, "without a budget: how many of each group go to the end", low=1)
    seed: int = setting(0, "which scrambling of the Sobol sequence", low=0)


class TopK(Strategy):
    """A Sobol design at a low difficulty, then its best points at z = 1, best first."""

    name = "top_k"
    summary = "all for one short round, then the best few to the end"
    uses_values = True
    uses_z = True
    Settings = TopKSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:  # noqa: ARG002  # a design
        """Short rounds until their share is used up, then promotions; fewer where the budget is used up."""
        s = self.settings
        costs = CostModel(record)
        paid = spent(record, costs)
        short = record.z < 1
        pending_short = record.pending_z < 1
        paid_short = float(record.cost[short].sum()) + costs.at(s.z) * int(pending_short.sum())
        shorts = int(short.sum() + pending_short.sum())
        budget = math.inf if s.cost_budget is None else s.cost_budget
        asked = record.asked
        queue = self._promotions(record)
        promoted = int((record.z == 1).sum() + (record.pending_z == 1).sum())
        found: list[Candidate] = []
        while len(found) < count and paid + 0.5 * costs.at(s.z) <= budget:
            if s.cost_budget is None:
                to_end = promoted < (shorts // s.group) * s.k
            else:
                to_end = paid_short + costs.at(s.z) > s.share * budget
            if to_end and queue:
                row = queue.pop(0)
                found.append(Candidate(record.params[row], 1.0, row, {"mode": "promote"}))
                promoted += 1
                paid += costs.at(1.0)
                continue
            if to_end and len(record.pending):
                break  # nothing to promote until the short round is in
            u = next_sobol(self.space, asked, 1, s.seed)[0]
            found.append(Candidate(self.space.from_unit(u), s.z, None, {"mode": "short round"}))
            asked = np.concatenate([asked, u[None, :]])
            shorts += 1
            paid += costs.at(s.z)
            paid_short += costs.at(s.z)
        return found

    @staticmethod
    def _promotions(record: Record) -> list[int]:
        """Short observations not yet taken to the end, best first."""
        ends = {u.tobytes() for u in record.X[record.z == 1]} | {
            u.tobytes() for u in record.pending[record.pending_z == 1]
        }
        rows = [
            int(i)
            for i in np.flatnonzero(record.complete & (record.z < 1) & ~np.isnan(record.value))
            if record.X[i].tobytes() not in ends
        ]
        return sorted(rows, key=lambda i: (-record.value[i], i))
