"""The cases, one file a category. `CASES` is all of them, in the order of their numbers."""

from typing import Final

from nmes.conformance.case import Case, Category
from nmes.conformance.cases.auth import AUTH
from nmes.conformance.cases.dialects import DIALECTS
from nmes.conformance.cases.framing import FRAMING
from nmes.conformance.cases.strictness import JSON

__all__ = ["CASES", "CATEGORIES"]

CATEGORIES: Final[tuple[Category, ...]] = (FRAMING, AUTH, DIALECTS, JSON)
CASES: Final[tuple[Case, ...]] = tuple(case for category in CATEGORIES for case in category)
