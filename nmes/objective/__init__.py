"""Objectives: CEL expressions over the quantities of bodies, and how those are computed."""

from __future__ import annotations

from nmes.objective.expression import FUNCTIONS, Condition, Objective
from nmes.objective.quantities import CUBE_QUANTITIES, FOLDS, MEETING_QUANTITIES, QUANTITIES, Cast, Quantity

__all__ = [
    "CUBE_QUANTITIES",
    "FOLDS",
    "FUNCTIONS",
    "MEETING_QUANTITIES",
    "QUANTITIES",
    "Cast",
    "Condition",
    "Objective",
    "Quantity",
]
