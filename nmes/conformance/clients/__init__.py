"""Whether a client speaks the protocol: a server that is played by script, and a driver that has the client act.

`nmes conform-client` runs it, `judge` does the same in process. The driver is a small program around the client under
test, which reads one instruction a line and writes one answer a line: docs/client-conformance.md says which.
"""

from nmes.conformance.clients.case import ClientCase
from nmes.conformance.clients.driver import NoDriver
from nmes.conformance.clients.runner import CLIENT_CASES, ClientResult, NoPort, judge, select_client_cases

__all__ = ["CLIENT_CASES", "ClientCase", "ClientResult", "NoDriver", "NoPort", "judge", "select_client_cases"]
