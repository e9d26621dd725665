"""The contract of a physics engine, as tests that its author runs: `class TestMine(BackendContract): backend = Mine`.

It hides how each promise of `nmes.backend` is put to the test. Every check is a method `test_*` that makes its own
simulations and needs no pytest, so that any runner will do; one whose capability is not promised is skipped. What an
engine does approximately is compared with the physics, within tolerances that a subclass may declare otherwise.

Everything stays in the XY plane, with hinges about z, so that the same checks hold in two dimensions and in three;
what only three have is checked where `dims` is 3.
"""

from nmes.backend.contract.bodies import BodyChecks
from nmes.backend.contract.joints import JointChecks
from nmes.backend.contract.media import MediumChecks
from nmes.backend.contract.programs import program_digest, random_program
from nmes.backend.contract.shapes import ShapeChecks
from nmes.backend.contract.trust import TrustChecks

__all__ = ["BackendContract", "program_digest", "random_program"]


class BackendContract(TrustChecks, BodyChecks, JointChecks, ShapeChecks, MediumChecks):
    """All that an engine promises. Subclass it as `TestSomething` and set `backend`; `base.Checks` has the settings."""
