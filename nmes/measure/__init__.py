"""What things cost on this machine: crowds of cubes, agents and connections, encodings of messages, peers, installs.

Each measurement compares: it does two or more things in turns, in one process, and tells their ratio, so that a slow or
busy machine is slow to all of them. What it computes besides follows from its seed and is told as a digest, so that
whoever measures again knows that it was the same that was measured.
"""

from __future__ import annotations
