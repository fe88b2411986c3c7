"""Random streams: one per environment and purpose, each the 128-bit state of a xoroshiro128++ generator.

A stream is a row of two uint64, changed in place, so the state of a batch is an array (N, S, 2) which can be stored
and put back. What one purpose draws never shifts what another draws, nor does an environment shift its neighbour.

Sources: D. Blackman, S. Vigna, "Scrambled linear pseudorandom number generators" (ACM TOMS 2021), for xoroshiro128++;
G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators" (OOPSLA 2014), for SplitMix64;
G. Marsaglia, W. Tsang, "The ziggurat method for generating random variables" (J. Stat. Softw. 2000), with the layer
and the position taken from different bits (J. Doornik, 2005); G. Box, M. Muller, "A note on the generation of random
normal deviates" (Ann. Math. Stat. 1958).
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.elementary import log, sin_cos
from relloc_env.kernels.lanes import W, natural

SCENARIO, IMAGE, ODOMETRY, NETWORK, ACTUATOR, PICTURE = range(6)
"""Purposes: index of the stream along the axis S."""
PURPOSES = 6

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_2, _11, _17, _21, _27, _28, _30, _31, _32, _49, _64 = (
    np.uint64(n) for n in (2, 11, 17, 21, 27, 28, 30, 31, 32, 49, 64)
)
_8, _1 = np.uint64(8), np.uint64(1)
_LAYER, _LOW = np.uint64(0xFF), np.uint64(0xFFFFFFFF)
_UNIT = 2.0**-53
_TURN = 2.0 * math.pi

_LAYERS = 256
_TAIL = 3.6541528853610088


def _ziggurat() -> tuple[np.ndarray, np.ndarray]:
    """Edges x_i and heights f(x_i) of 256 layers of equal area under f(x) = exp(-x²/2); the first holds the tail."""
    area = _TAIL * math.exp(-0.5 * _TAIL**2) + math.sqrt(0.5 * math.pi) * math.erfc(_TAIL / math.sqrt(2.0))
    edges, heights = np.zeros(_LAYERS + 1), np.ones(_LAYERS + 1)
    edges[1], heights[1] = _TAIL, math.exp(-0.5 * _TAIL**2)
    edges[0], heights[0] = area / heights[1], 0.0
    for i in range(1, _LAYERS - 1):
        heights[i + 1] = heights[i] + area / edges[i]
        edges[i + 1] = math.sqrt(-2.0 * math.log(heights[i + 1]))
    return edges, heights


_EDGES, _HEIGHTS = _ziggurat()


@kernel
def mix(z):
    """The output function of SplitMix64, a bijection of 64 bits. `z` is a uint64."""
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@kernel
def seed_stream(stream, seed, purpose):
    """Start a stream: outputs number 2 purpose and 2 purpose + 1 of the SplitMix64 generator started at mix(seed).

    Two different (seed, purpose) share a state with a probability of about 2^-128 only, and no state is zero.

    Args:
        stream: uint64 (2,) changed in place.
        seed: from 0 to 2^64 - 1 (above 2^63 - 1 as a np.uint64).
        purpose: from 0; see `SCENARIO` and its neighbours.
    """
    start = mix(np.uint64(seed) + _GOLDEN) + _2 * np.uint64(purpose) * _GOLDEN
    stream[0] = mix(start + _GOLDEN)
    stream[1] = mix(start + _2 * _GOLDEN)


@kernel
def seed_streams(streams, rows, seeds):
    """Start all streams of the environments `rows` from one seed each: uint64 (N, S, 2) and (len(rows),)."""
    for i in range(rows.shape[0]):
        for purpose in range(streams.shape[1]):
            seed_stream(streams[rows[i], purpose], seeds[i], purpose)


@inlined
def advance_state(s0, s1):
    """One step of xoroshiro128++ (rotations 49, 21, 28): (output, s0, s1), all uint64."""
    total = s0 + s1
    output = ((total << _17) | (total >> (_64 - _17))) + s0
    s1 ^= s0
    return output, ((s0 << _49) | (s0 >> (_64 - _49))) ^ s1 ^ (s1 << _21), (s1 << _28) | (s1 >> (_64 - _28))


@inlined
def unit(bits):
    """The upper 53 bits of a uint64 as a number in [0, 1)."""
    return float(np.int64(bits >> _11)) * _UNIT


@kernel
def next_u64(stream):
    """Next 64 random bits. `stream`: uint64 (2,) changed in place."""
    bits, stream[0], stream[1] = advance_state(stream[0], stream[1])
    return bits


@kernel
def uniform(stream):
    """Uniform in [0, 1), a multiple of 2^-53. `stream`: uint64 (2,) changed in place."""
    return unit(next_u64(stream))


@kernel
def integer(stream, n):
    """Uniform integer in [0, n), 1 <= n <= 2^32, without bias (D. Lemire, 2019). `stream`: uint64 (2,) in place."""
    n = np.uint64(n)
    product = (next_u64(stream) >> _32) * n
    if product & _LOW < n:
        least = (_LOW + _1 - n) % n
        while product & _LOW < least:
            product = (next_u64(stream) >> _32) * n
    return np.int64(product >> _32)


@kernel
def normal(stream):
    """Standard normal by the ziggurat of 256 layers, exact in the tail too. `stream`: uint64 (2,) changed in place."""
    x, stream[0], stream[1] = _normal(stream[0], stream[1])
    return x


@kernel
def _normal(s0, s1):
    """(standard normal, s0, s1): the state is held as numbers."""
    while True:
        bits, s0, s1 = advance_state(s0, s1)
        layer = np.int64(bits & _LAYER)
        sign = 1.0 - 2.0 * float(np.int64((bits >> _8) & _1))
        x = unit(bits) * _EDGES[layer]
        if x < _EDGES[layer + 1]:
            break
        if layer == 0:
            over, depth = 0.0, -1.0
            while depth <= over * over:
                bits, s0, s1 = advance_state(s0, s1)
                over = -math.log(1.0 - unit(bits)) / _TAIL
                bits, s0, s1 = advance_state(s0, s1)
                depth = -2.0 * math.log(1.0 - unit(bits))
            x = _TAIL + over
            break
        bits, s0, s1 = advance_state(s0, s1)
        if _HEIGHTS[layer] + unit(bits) * (_HEIGHTS[layer + 1] - _HEIGHTS[layer]) < math.exp(-0.5 * x * x):
            break
    return sign * x, s0, s1


@kernel
def draw_u64(streams, rows, purpose, out):
    """Draw 64 random bits of each of the environments `rows` for a purpose: uint64 (N, S, 2) and (len(rows),)."""
    for i in range(rows.shape[0]):
        out[i] = next_u64(streams[rows[i], purpose])


@inlined
def stream_of(streams, n, purpose):
    """The stream of environment n for a purpose, of the flat array of all: uint64 (2,), live."""
    at = 2 * (n * PURPOSES + purpose)
    return streams[at : at + 2]


@kernel
def fill_pairs(streams, n, purpose, t, place, step, count):
    """Draw `count` pairs of uniform numbers of environment n, into places p and p + W for p = place, place + step, ...

    The first of a pair is above 0 and at most 1, the second from 0 and below 1: what `make_normal` takes. `streams`
    is flat.
    """
    at = natural(2 * (n * PURPOSES + purpose))
    s0, s1 = streams[at], streams[at + 1]
    for k in range(count):
        p = natural(place + k * step)
        bits, s0, s1 = advance_state(s0, s1)
        t[p] = 1.0 - unit(bits)
        bits, s0, s1 = advance_state(s0, s1)
        t[p + W] = unit(bits)
    streams[at], streams[at + 1] = s0, s1


@kernel
def make_normal(t, place, step, count, width):
    """Turn `count` such pairs into standard normals, in all lanes (Box and Muller): quicker there than the ziggurat."""
    for k in range(count):
        p = natural(place + k * step)
        for i in range(width):
            radius = np.sqrt(-2.0 * log(t[p + i]))
            sin, cos = sin_cos(_TURN * t[p + i + W])
            t[p + i], t[p + i + W] = radius * cos, radius * sin


@kernel
def fill_uniforms(streams, n, purpose, t, place, step, count):
    """Draw `count` numbers uniform in [0, 1) into places place, place + step, ...; `streams` is flat."""
    at, place = natural(2 * (n * PURPOSES + purpose)), natural(place)
    s0, s1 = streams[at], streams[at + 1]
    for k in range(count):
        bits, s0, s1 = advance_state(s0, s1)
        t[natural(place + k * step)] = unit(bits)
    streams[at], streams[at + 1] = s0, s1
