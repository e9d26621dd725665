"""Principal components: along which directions observations vary most, and by how much.

    found = principal_components(observations)
    found.directions[0], found.variances[0] / found.variances.sum()

For a creature's positions these are its principal motions. The eigenvectors of the covariances are found by turning
one pair of axes at a time (C. G. J. Jacobi, 1846; G. H. Golub and C. F. Van Loan, "Matrix computations", 8.5), in one
order, so that they have the same bits everywhere.

Source: H. Hotelling, "Analysis of a complex of statistical variables into principal components" (1933).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from nmes.backend import Array
from nmes.learning.learners.arithmetic import gathered, weighed

__all__ = ["Components", "principal_components"]

_SWEEPS = 60  # of all pairs; a dozen are enough for any matrix


@dataclass(frozen=True, eq=False, slots=True)
class Components:
    """Principal components.

    Attributes:
        means: Array (columns,): of the observations.
        directions: Array (columns, columns): a row for each component, of length 1 and at right angles to all others,
            that with the greatest variance first. The greatest number of each row is positive.
        variances: Array (columns,): along each direction.
    """

    means: Array
    directions: Array
    variances: Array

    def apply(self, observations: Array, count: int) -> Array:
        """Returns how far observations (n, columns) are along the first components, shape (n, count)."""
        return weighed(observations - self.means, self.directions[:count])


def principal_components(observations: Array) -> Components:
    """Returns the principal components of observations (n, columns).

    Raises:
        ValueError: There are fewer than 2 observations.
    """
    if len(observations) < 2:
        raise ValueError(f"there are no directions among {len(observations)} observations: 2 or more are needed")
    means = np.add.reduce(observations, axis=0) / len(observations)
    away = observations - means
    variances, directions = _eigen(gathered(away, away) / (len(observations) - 1))
    order = np.argsort(-variances, kind="stable")
    directions, variances = directions[order], np.maximum(variances[order], 0.0)
    signs = np.array([1.0 if row[np.argmax(np.abs(row))] >= 0.0 else -1.0 for row in directions])
    return Components(means, np.ascontiguousarray(directions * signs[:, None]), variances)


def _eigen(matrix: Array) -> tuple[Array, Array]:
    """Returns the eigenvalues of a symmetric matrix, and a row for each eigenvector."""
    matrix, count = matrix.copy(), len(matrix)
    vectors = np.eye(count)
    least = 1e-15 * float(np.max(np.abs(matrix), initial=0.0))
    for _ in range(_SWEEPS):
        turned = False
        for one in range(count):
            for other in range(one + 1, count):
                if abs(matrix[one, other]) > least:
                    turned = True
                    _turn(matrix, vectors, one, other)
        if not turned:
            break
    return matrix.diagonal().copy(), vectors


def _turn(matrix: Array, vectors: Array, one: int, other: int) -> None:
    """Turns two axes so that the number where they meet becomes 0."""
    half = float(matrix[other, other] - matrix[one, one]) / (2.0 * float(matrix[one, other]))
    tangent = (1.0 if half >= 0.0 else -1.0) / (abs(half) + sqrt(half * half + 1.0))
    cosine = 1.0 / sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for array in (matrix, matrix.T, vectors):
        first, second = array[one].copy(), array[other].copy()
        array[one], array[other] = cosine * first - sine * second, sine * first + cosine * second
    matrix[one, other] = matrix[other, one] = 0.0
