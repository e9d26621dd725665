"""The cases, one file a category, or several for a large one. `CASES` is all of them, by category."""

from typing import Final

from nmes.conformance.case import Case, Category
from nmes.conformance.cases.auth import AUTH
from nmes.conformance.cases.capabilities import CAPABILITIES
from nmes.conformance.cases.clients import CLIENTS
from nmes.conformance.cases.commands import CONTRACTS
from nmes.conformance.cases.creatures import CREATURES
from nmes.conformance.cases.determinism import DETERMINISM
from nmes.conformance.cases.dialects import DIALECTS
from nmes.conformance.cases.errors import ERRORS
from nmes.conformance.cases.fields import FIELDS
from nmes.conformance.cases.framing import FRAMING
from nmes.conformance.cases.limits import LIMITS
from nmes.conformance.cases.names import NAMES
from nmes.conformance.cases.objectives import OBJECTIVES
from nmes.conformance.cases.physics import PHYSICS
from nmes.conformance.cases.robustness import ROBUSTNESS
from nmes.conformance.cases.roles import ROLES
from nmes.conformance.cases.search import SEARCH
from nmes.conformance.cases.strictness import JSON
from nmes.conformance.cases.subscriptions import SUBSCRIPTIONS
from nmes.conformance.cases.timing import TIME

__all__ = ["CASES", "CATEGORIES"]

CATEGORIES: Final[tuple[Category, ...]] = (
    FRAMING,
    AUTH,
    DIALECTS,
    JSON,
    CONTRACTS,
    FIELDS,
    ERRORS,
    NAMES,
    CLIENTS,
    TIME,
    SUBSCRIPTIONS,
    LIMITS,
    PHYSICS,
    DETERMINISM,
    ROBUSTNESS,
    CAPABILITIES,
    SEARCH,
    CREATURES,
    OBJECTIVES,
    ROLES,
)
CASES: Final[tuple[Case, ...]] = tuple(case for category in CATEGORIES for case in category)
