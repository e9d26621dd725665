"""Addresses of hosts as people write them."""

from __future__ import annotations

__all__ = ["read_address"]


def read_address(text: str, default: int | None = None) -> tuple[str, int]:
    """Returns the host and the port of HOST:PORT, where HOST may be an IPv6 address in brackets.

    Args:
        text: The address.
        default: The port where there is only HOST; None: there must be one.

    Raises:
        ValueError: It is no address, with the reason.
    """
    host, colon, port = (text, "", "") if text.endswith("]") or ":" not in text else text.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    if not bare or (":" in bare and host == bare) or not bare.isprintable() or " " in bare:
        raise ValueError("it has no host")
    try:
        bare.encode("idna")  # which is what connecting does first
    except UnicodeError as error:
        raise ValueError("it has no host whose name could be looked up") from error
    if not colon and default is not None:
        return bare, default
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) <= 65535):
        raise ValueError("a port is from 1 to 65535")
    return bare, int(port)
