"""The wire protocol without I/O: bytes in, commands out; replies in, bytes out.

It hides framing, strict JSON, validation against the schemas, and the two dialects. `parse` turns one frame
into a `Request`; a `Session` is one connection's protocol state. Neither ever raises for what a peer sends: a frame
that is no valid command becomes a Request with an `error`, and a stream that can no longer be trusted is a
`Session.violation`. Invariants: how bytes are cut into pieces changes nothing; every number in a valid command is
finite and within its schema's bounds; what `encode` returns never contains the delimiter.
"""

from __future__ import annotations

from nmes.protocol.messages import (
    COMMANDS,
    DELIMITER,
    ERROR_CODES,
    EVENTS,
    NO_ID,
    PROTOCOL_VERSION,
    REPLIES,
    CommandSchema,
    Request,
    bundled_schema,
    complete_config,
    decode,
    encode,
    error_reply,
    parse,
    request_from,
    validate_event,
    validate_metadata,
    validate_reply,
)
from nmes.protocol.session import PASSWORD_VARIABLE, REDACTED, Auth, FrameSplitter, Limits, Session
from nmes.schemas import schema_hash
from nmes.schemas.documents import parse_json

__all__ = [
    "COMMANDS",
    "DELIMITER",
    "ERROR_CODES",
    "EVENTS",
    "NO_ID",
    "PASSWORD_VARIABLE",
    "PROTOCOL_VERSION",
    "REDACTED",
    "REPLIES",
    "Auth",
    "CommandSchema",
    "FrameSplitter",
    "Limits",
    "Request",
    "Session",
    "bundled_schema",
    "complete_config",
    "decode",
    "encode",
    "error_reply",
    "parse",
    "parse_json",
    "request_from",
    "schema_hash",
    "validate_event",
    "validate_metadata",
    "validate_reply",
]
