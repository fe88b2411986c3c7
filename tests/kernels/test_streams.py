"""Random streams against published outputs, a generator in Python's own integers, and SciPy's distributions."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from relloc_env.kernels import streams
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.lanes import W

MASK = 2**64 - 1
DRAWS = 1_000_000


@kernel
def _draw_normal(stream, out):
    for i in range(out.size):
        out[i] = streams.normal(stream)


@kernel
def _draw_uniform(stream, out):
    for i in range(out.size):
        out[i] = streams.uniform(stream)


@kernel
def _draw_integer(stream, n, out):
    for i in range(out.size):
        out[i] = streams.integer(stream, n)


@kernel
def _draw_pairs(state, lanes, steps, out):
    """Standard normals of the environments `lanes`, side by side, a pair of each at every step."""
    t = np.zeros(2 * W)
    for k in range(steps):
        for n in range(lanes):
            streams.fill_pairs(state, n, streams.IMAGE, t, n, W, 1)
        streams.make_normal(t, 0, 2 * W, 1, W)
        for n in range(lanes):
            out[n, 2 * k], out[n, 2 * k + 1] = t[n], t[n + W]


def _stream(seed: int, purpose: int = streams.SCENARIO) -> NDArray[np.uint64]:
    state = np.zeros((1, streams.PURPOSES, 2), dtype=np.uint64)
    streams.seed_stream(state[0, purpose], np.uint64(seed), purpose)
    return state[0, purpose]


def _splitmix(state: int, index: int) -> int:
    """Output number `index` of the published SplitMix64, in unbounded integers."""
    z = (state + (index + 1) * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def test_xoroshiro_published_outputs() -> None:
    """State (1, 2): the first ten outputs of the authors' C code, as the tests of Rust's rand_xoshiro print them."""
    expected = [
        393217,
        669327710093319,
        1732421326133921491,
        11394790081659126983,
        9555452776773192676,
        3586421180005889563,
        1691397964866707553,
        10735626796753111697,
        15216282715349408991,
        14247243556711267923,
    ]
    state = np.array([1, 2], dtype=np.uint64)
    assert [int(streams.next_u64(state)) & MASK for _ in expected] == expected


def test_splitmix_published_outputs() -> None:
    """Seed 1234567: the five outputs that Rosetta Code publishes ("Pseudo-random numbers/Splitmix64")."""
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    starts = [(1234567 + (i + 1) * 0x9E3779B97F4A7C15) & MASK for i in range(5)]
    assert [int(streams.mix(np.uint64(start))) & MASK for start in starts] == expected
    assert [_splitmix(1234567, i) for i in range(5)] == expected


@pytest.mark.parametrize("seed", [0, 1, 42, 2**63, MASK])
@pytest.mark.parametrize("purpose", range(streams.PURPOSES))
def test_seeding(seed: int, purpose: int) -> None:
    start = _splitmix(seed, 0)
    expected = [_splitmix(start, 2 * purpose), _splitmix(start, 2 * purpose + 1)]
    assert [int(word) for word in _stream(seed, purpose)] == expected


def test_seeding_leaves_the_other_streams() -> None:
    state = np.zeros((3, streams.PURPOSES, 2), dtype=np.uint64)
    streams.seed_stream(state[1, streams.ODOMETRY], 5, streams.ODOMETRY)
    assert np.argwhere(state.any(axis=-1)).tolist() == [[1, streams.ODOMETRY]]


def test_outputs_against_python_integers() -> None:
    """1000 outputs from each of 3 seeds."""

    def rotate(x: int, k: int) -> int:
        return ((x << k) | (x >> (64 - k))) & MASK

    for seed in (0, 7, MASK):
        state = _stream(seed, streams.IMAGE)
        s0, s1 = (int(word) for word in state)
        for _ in range(1000):
            expected = (rotate((s0 + s1) & MASK, 17) + s0) & MASK
            s1 ^= s0
            s0, s1 = rotate(s0, 49) ^ s1 ^ ((s1 << 21) & MASK), rotate(s1, 28)
            assert int(streams.next_u64(state)) & MASK == expected


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_uniform(seed: int) -> None:
    """10^6 draws of each of 3 seeds: Kolmogorov-Smirnov, and chi² of the 10 lowest of the 53 bits."""
    draws = np.zeros(DRAWS)
    _draw_uniform(_stream(seed), draws)
    assert draws.min() >= 0.0
    assert draws.max() < 1.0
    assert stats.kstest(draws, "uniform").pvalue > 1e-3
    low = (draws * 2.0**53).astype(np.int64) % 1024
    assert stats.chisquare(np.bincount(low, minlength=1024)).pvalue > 1e-3


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_normal(seed: int) -> None:
    """10^6 draws of each of 3 seeds: Kolmogorov-Smirnov, moments, and 1000 cells of equal probability."""
    draws = np.zeros(DRAWS)
    _draw_normal(_stream(seed, streams.ODOMETRY), draws)
    assert stats.kstest(draws, "norm").pvalue > 1e-3
    for power, moment in enumerate([0.0, 1.0, 0.0, 3.0, 0.0, 15.0], start=1):
        spread = np.std(draws**power) / np.sqrt(DRAWS)
        assert np.mean(draws**power) == pytest.approx(moment, abs=4.0 * spread)
    cells = np.minimum((stats.norm.cdf(draws) * 1000).astype(int), 999)
    assert stats.chisquare(np.bincount(cells, minlength=1000)).pvalue > 1e-3


def test_normals_in_lanes() -> None:
    """10^6 draws: Kolmogorov-Smirnov of numbers, radii, angles; no correlation; the same alone; the first by NumPy."""
    lanes, steps = 8, DRAWS // 16
    state = np.zeros((lanes, streams.PURPOSES, 2), dtype=np.uint64)
    streams.seed_streams(state, np.arange(lanes), np.arange(lanes, dtype=np.uint64))
    alone = state[3:4].copy()
    draws, single = np.zeros((lanes, 2 * steps)), np.zeros((1, 200))
    _draw_pairs(state.reshape(-1), lanes, steps, draws)
    _draw_pairs(alone.reshape(-1), 1, 100, single)
    np.testing.assert_array_equal(single[0], draws[3, :200])
    assert stats.kstest(draws.ravel(), "norm").pvalue > 1e-3
    x, y = draws[:, ::2].ravel(), draws[:, 1::2].ravel()
    assert stats.kstest(x * x + y * y, "expon", args=(0.0, 2.0)).pvalue > 1e-3
    assert stats.kstest(np.arctan2(y, x), "uniform", args=(-np.pi, 2.0 * np.pi)).pvalue > 1e-3
    for a, b in ((x, y), (x[1:], x[:-1]), (draws[0], draws[1])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.0 / np.sqrt(len(a))
    uniform = state[:1].copy()
    streams.seed_streams(uniform, np.zeros(1, np.int64), np.zeros(1, np.uint64))
    u, v = (streams.uniform(uniform[0, streams.IMAGE]) for _ in range(2))
    radius = np.sqrt(-2.0 * np.log(1.0 - u))
    np.testing.assert_allclose(
        draws[0, :2], radius * np.array([np.cos(2 * np.pi * v), np.sin(2 * np.pi * v)]), rtol=1e-12
    )


def test_normal_tail() -> None:
    """Beyond the last layer, x > 3.65415: number, sign and distribution of the tail in 2·10^7 draws (about 5160)."""
    draws = np.zeros(DRAWS)
    state = _stream(11, streams.IMAGE)
    tail = []
    for _ in range(20):
        _draw_normal(state, draws)
        tail.append(draws[np.abs(draws) > 3.65415])
    beyond = np.concatenate(tail)
    probability = 2.0 * stats.norm.sf(3.65415)
    assert stats.binomtest(beyond.size, 20 * DRAWS, probability).pvalue > 1e-3
    assert stats.binomtest(int((beyond > 0).sum()), beyond.size, 0.5).pvalue > 1e-3
    assert stats.kstest(stats.norm.sf(np.abs(beyond)) / stats.norm.sf(3.65415), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("n", [1, 2, 7, 1000, 3 * 2**30, 2**32])
def test_integer(n: int) -> None:
    """10^5 draws for each n; at 3·2^30 a biased reduction would favour every third value."""
    draws = np.zeros(100_000, dtype=np.int64)
    _draw_integer(_stream(3, streams.NETWORK), n, draws)
    assert draws.min() >= 0
    assert draws.max() < n
    if n > 1:
        cells = min(n, 100)
        counts = np.bincount(draws * cells // n, minlength=cells)
        edges = -(-np.arange(cells + 1) * n // cells)
        assert stats.chisquare(counts, np.diff(edges) / n * draws.size).pvalue > 1e-3
    if n == 3 * 2**30:
        assert stats.chisquare(np.bincount(draws % 3, minlength=3)).pvalue > 1e-3


def test_neighbouring_streams_are_independent() -> None:
    """First 8 draws of 20,000 neighbouring seeds and all purposes: uniform as one sample, and uncorrelated."""
    seeds, first = 20_000, 8
    draws = np.zeros((seeds, streams.PURPOSES, first))
    for seed in range(seeds):
        for purpose in range(streams.PURPOSES):
            _draw_uniform(_stream(seed, purpose), draws[seed, purpose])
    assert np.unique(draws).size == draws.size
    assert stats.kstest(draws.ravel(), "uniform").pvalue > 1e-3
    across_seeds = [stats.pearsonr(draws[:-1, p].ravel(), draws[1:, p].ravel()).pvalue for p in range(streams.PURPOSES)]
    across_purposes = [
        stats.pearsonr(draws[:, p].ravel(), draws[:, q].ravel()).pvalue
        for p in range(streams.PURPOSES)
        for q in range(p)
    ]
    assert min(across_seeds) > 1e-3
    assert min(across_purposes) > 1e-3
    columns = np.corrcoef(draws.reshape(seeds, -1), rowvar=False)
    assert np.abs(np.triu(columns, k=1)).max() * np.sqrt(seeds) < 5.0


def test_a_stored_stream_goes_on() -> None:
    """The state is all there is: 100 draws after a copy equal 100 draws of the original."""
    state = _stream(9, streams.ACTUATOR)
    draws = np.zeros(100)
    _draw_normal(state, draws)
    copy = state.copy()
    again = np.zeros(100)
    _draw_normal(state, draws)
    _draw_normal(copy, again)
    np.testing.assert_array_equal(draws, again)
