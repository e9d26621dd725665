"""The log of `nmes serve`, as text for people or as one JSON object a line.

Invariant: whatever strangers do again and again, the log grows by no more than a line a minute for each kind of line.
"""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime

from nmes.errors import visible

__all__ = ["Seldom", "set_up"]

AT_ONCE = 20  # lines of a kind
MINUTE = 60.0  # s: how long until there may be one more


class _Json(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        entry = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, ensure_ascii=False)


class _Text(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:
        """Returns the line, in which names of strangers cannot begin another one or command the terminal."""
        record.message = visible(record.message)
        return super().formatMessage(record)


class Seldom(logging.Filter):
    """Lets so many lines of a kind through, then one a minute, which says how many were left out before it.

    Lines are of a kind where they come from the same place in the code.
    """

    def __init__(self) -> None:
        super().__init__()
        self._kinds: dict[tuple[str, int], tuple[float, float, int]] = {}  # lines it may have, since when; left out

    def filter(self, record: logging.LogRecord) -> bool:
        """Tells whether a line is written; one that is may be added to."""
        kind, now = (record.pathname, record.lineno), record.created
        allowed, since, left = self._kinds.get(kind, (float(AT_ONCE), now, 0))
        allowed = min(float(AT_ONCE), allowed + max(0.0, now - since) / MINUTE)
        written = allowed >= 1.0
        self._kinds[kind] = (allowed - 1.0, now, 0) if written else (allowed, now, left + 1)
        if written and left:
            record.msg, record.args = f"{record.getMessage()} ({left:,} more like this were left out)", ()
        return written


def set_up(style: str) -> None:
    """Writes the log of this process to standard error, as `text` or `json`."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Json() if style == "json" else _Text("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.addFilter(Seldom())
    logging.basicConfig(handlers=[handler], level=logging.INFO)
