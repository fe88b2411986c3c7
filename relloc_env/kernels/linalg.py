"""Dense linear algebra of a few dozen rows, in place and without allocation.

Matrices are the leading n × n part of a larger C-contiguous array, so that one workspace serves every size.
"""

import math

from relloc_env.kernels._compile import kernel


@kernel
def cholesky(a, n):
    """Factor a = L Lᵀ in place (lower triangle; the upper one is left as it is).

    Args:
        a: (≥ n, ≥ n) symmetric; only its lower triangle is read.
        n: number of rows in use.

    Returns:
        True; False where a pivot is not positive (then `a` is spoilt).
    """
    for j in range(n):
        pivot = a[j, j]
        for k in range(j):
            pivot -= a[j, k] * a[j, k]
        if not pivot > 0.0:
            return False
        pivot = math.sqrt(pivot)
        a[j, j] = pivot
        inverse = 1.0 / pivot
        for i in range(j + 1, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total * inverse
    return True


@kernel
def solve_factored(factor, b, n):
    """Solve L Lᵀ x = b in place: `b` (≥ n,) becomes x; `factor` as left by `cholesky`."""
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= factor[i, k] * b[k]
        b[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * b[k]
        b[i] = total / factor[i, i]


@kernel
def invert(a, inverse, n):
    """Write the inverse of a symmetric positive definite matrix into `inverse`; `a` is left as its factor.

    Returns:
        True; False where `a` is not positive definite (then both are spoilt).
    """
    if not cholesky(a, n):
        return False
    # The lower triangle of `inverse` becomes L⁻¹ by rows, then L⁻ᵀ L⁻¹.
    for i in range(n):
        scale = 1.0 / a[i, i]
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total -= a[i, k] * inverse[k, j]
            inverse[i, j] = total * scale
        inverse[i, i] = scale
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, n):
                total += inverse[k, i] * inverse[k, j]
            inverse[i, j] = total
    for i in range(n):
        for j in range(i):
            inverse[j, i] = inverse[i, j]
    return True


@kernel
def log_determinant(factor, n):
    """Logarithm of det(L Lᵀ), of the leading n rows of a factor."""
    total = 0.0
    for i in range(n):
        total += math.log(factor[i, i])
    return 2.0 * total
