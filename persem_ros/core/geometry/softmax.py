"""
Probabilities from logarithms, for kernels: exp() in a form that compilers turn into vectors.

The C library's exp() goes one number at a time and differs between machines; this one is the same
everywhere and a few units in the last place from the true value.

"""

from persem_ros.core.jit import inlined

LOG2_E = 1.4426950408889634
LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
MAGIC = 6755399441055744.0          # 1.5 * 2^52: adding it rounds to a whole number, half to even
MAGIC_BITS = 0x4338000000000000     # its representation; that of MAGIC + k is this + k
SMALLEST = -700.0                   # exp() of less is taken for exp() of this, 1e-304


@inlined
def softmax(K, Q, scratch, bits):
    """
    Replace Q[:K] by exp(Q) / sum of exp(Q).

    scratch (K,) float64 is written to, bits is scratch.view(np.int64).

    """
    whole_quads = K & ~3
    m0 = m1 = m2 = m3 = Q[0]        # four at a time: one would wait for the one before
    for z in range(0, whole_quads, 4):
        m0, m1 = max(m0, Q[z]), max(m1, Q[z + 1])
        m2, m3 = max(m2, Q[z + 2]), max(m3, Q[z + 3])
    most = max(max(m0, m1), max(m2, m3))
    for z in range(whole_quads, K):
        most = max(most, Q[z])
    for z in range(K):
        x = max(Q[z] - most, SMALLEST)
        scratch[z] = x * LOG2_E + MAGIC
        k = scratch[z] - MAGIC
        r = (x - k * LN2_HIGH) - k * LN2_LOW        # |r| <= ln 2 / 2
        p = 1.0 / 6227020800.0
        p = p * r + 1.0 / 479001600.0
        p = p * r + 1.0 / 39916800.0
        p = p * r + 1.0 / 3628800.0
        p = p * r + 1.0 / 362880.0
        p = p * r + 1.0 / 40320.0
        p = p * r + 1.0 / 5040.0
        p = p * r + 1.0 / 720.0
        p = p * r + 1.0 / 120.0
        p = p * r + 1.0 / 24.0
        p = p * r + 1.0 / 6.0
        p = p * r + 0.5
        p = p * r + 1.0
        Q[z] = p * r + 1.0
    for z in range(K):
        bits[z] = (bits[z] + 1023) << 52            # 2^k
    for z in range(K):
        Q[z] *= scratch[z]
    m0 = m1 = m2 = m3 = 0.0
    for z in range(0, whole_quads, 4):
        m0 += Q[z]
        m1 += Q[z + 1]
        m2 += Q[z + 2]
        m3 += Q[z + 3]
    for z in range(whole_quads, K):
        m0 += Q[z]
    inverse = 1.0 / ((m0 + m1) + (m2 + m3))
    for z in range(K):
        Q[z] *= inverse
