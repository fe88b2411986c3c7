"""A covariance kept as factors, P = U D Uᵀ: U (D, D) unit upper triangular, D a line of positive numbers (D,).

Variances are sums of squares, and updates multiply and add positive numbers, so digits last where those of P cancel
(G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, Academic Press 1977). U has its ones and
zeros written out.
"""

from relloc_env.kernels._compile import kernel


@kernel
def factorise(covariance, factor, variances):
    """Factor P = U D Uᵀ, from the last column to the first.

    What is not positive, as in a covariance that lost its digits, becomes 1e-15 of its variance.

    Args:
        covariance: (D, D) symmetric, positive on its diagonal; undefined afterwards.
        factor, variances: U and D, written.
    """
    for j in range(variances.shape[0]):
        variances[j] = 1e-15 * covariance[j, j]
    factor[:] = 0.0
    for j in range(variances.shape[0] - 1, -1, -1):
        factor[j, j] = 1.0
        variances[j] = max(variances[j], covariance[j, j])
        for i in range(j):
            factor[i, j] = covariance[i, j] / variances[j]
        for i in range(j):
            for k in range(i + 1):
                covariance[k, i] -= factor[k, j] * factor[i, j] * variances[j]


@kernel
def add(factor, variances, work, end, variance_a, variance_b):
    """P += variance_a a aᵀ + variance_b b bᵀ, with a and b the first rows of `work` (4, D), undefined afterwards.

    The update of Agee and Turner (Bierman 1977, chapter III), from the last row of U to the first, for both vectors
    in one sweep.

    Args:
        factor, variances: U and D, changed.
        work: (4, D)
        end: a and b are zero from here on.
        variance_a, variance_b: not negative.
    """
    for i in range(end - 1, -1, -1):
        a, b = work[0, i], work[1, i]
        for k in range(end - 1, i, -1):
            a -= work[0, k] * factor[i, k]
            between = factor[i, k] + work[2, k] * a
            b -= work[1, k] * between
            factor[i, k] = between + work[3, k] * b
        work[0, i], work[1, i], work[2, i], work[3, i] = a, b, 0.0, 0.0
        if a != 0.0 or b != 0.0:
            first = variances[i] + variance_a * a * a
            second = first + variance_b * b * b
            work[2, i], variance_a = variance_a * a / first, variance_a * variances[i] / first
            work[3, i], variance_b = variance_b * b / second, variance_b * first / second
            variances[i] = second


@kernel
def correct(factor, variances, work, begin, row_a, row_b, variance_a, variance_b):
    """Take in two measurements, a · e and b · e, of three numbers e = E x.

    Bierman's update (1977, chapter V): f = Uᵀ h, alpha_k = variance + sum of d_j f_j² for j <= k, d_k *=
    alpha_{k-1} / alpha_k, column k of U -= f_k / alpha_{k-1} times the gain so far. Both go in one sweep: f of the
    second changes by the first as another row of U would.

    Args:
        factor, variances: U and D, changed.
        work: (4, D) its first three rows E U; undefined afterwards.
        begin: the columns of E U before this one are zero.
        row_a, row_b: three numbers each.
        variance_a, variance_b: of the measurements' noise.
    """
    alpha_a, alpha_b, inverse_a, inverse_b, product = variance_a, variance_b, 1.0 / variance_a, 1.0 / variance_b, 0.0
    for k in range(begin):
        work[0, k], work[2, k] = 0.0, 0.0
    for k in range(begin, variances.shape[0]):
        x, y, h, d = work[0, k], work[1, k], work[2, k], variances[k]
        a, b = row_a[0] * x + row_a[1] * y + row_a[2] * h, row_b[0] * x + row_b[1] * y + row_b[2] * h
        gain_a, step_a, before = d * a, a * inverse_a, alpha_a
        alpha_a += a * gain_a
        inverse_a = 1.0 / alpha_a
        d *= before * inverse_a
        b, product = b - step_a * product, product + gain_a * b
        gain_b, step_b, before = d * b, b * inverse_b, alpha_b
        alpha_b += b * gain_b
        inverse_b = 1.0 / alpha_b
        variances[k] = d * (before * inverse_b)
        work[0, k], work[1, k], work[2, k], work[3, k] = gain_a, step_a, gain_b, step_b
    for i in range(variances.shape[0] - 1):
        gain_a, gain_b = work[0, i], work[2, i]
        for k in range(max(i + 1, begin), variances.shape[0]):
            old = factor[i, k]
            new = old - work[1, k] * gain_a
            gain_a += work[0, k] * old
            factor[i, k] = new - work[3, k] * gain_b
            gain_b += work[2, k] * new
