"""Objectives: CEL expressions over the quantities of bodies, and how those are computed."""

from __future__ import annotations

from nmes.objective.expression import CUBE_QUANTITIES, FOLDS, FUNCTIONS, QUANTITIES, Condition, Objective, Quantity

__all__ = ["CUBE_QUANTITIES", "FOLDS", "FUNCTIONS", "QUANTITIES", "Condition", "Objective", "Quantity"]
