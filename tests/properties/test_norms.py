"""Norms and Riccati-based synthesis on random systems: bounds that must hold whatever the numbers."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gustproof.robust.lti.norms import h2_norm, hinf_norm
from gustproof.robust.lti.state_space import Lti, gain, series

ROUNDING = 1e-8
"""Relative; the norm promises 2e-9 and the responses round."""


@st.composite
def stable_systems(draw: st.DrawFn) -> Lti:
    seed, n = draw(st.integers(0, 2**32 - 1)), draw(st.integers(1, 6))
    damping = 10.0 ** draw(st.floats(-5.0, 0.0))
    discrete, direct = draw(st.booleans()), draw(st.booleans())
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    if discrete:
        A *= (1.0 - 0.5 * damping) / max(np.max(np.abs(np.linalg.eigvals(A))), 1e-3)
    else:
        A -= (np.max(np.linalg.eigvals(A).real) + damping) * np.eye(n)
    return Lti(
        A=A,
        B=rng.normal(size=(n, 2)),
        C=rng.normal(size=(2, n)),
        D=rng.normal(size=(2, 2)) * direct,
        dt=0.01 if discrete else 0.0,
    )


def frequencies(G: Lti) -> np.ndarray:
    poles = G.poles()
    natural = np.abs(np.angle(poles)) / G.dt if G.dt else np.abs(poles.imag)
    return np.concatenate([natural, np.geomspace(1e-4, np.pi / 0.01, 400)])


@settings(max_examples=60)
@given(stable_systems())
def test_no_frequency_exceeds_the_norm_and_its_frequency_attains_it(G):
    peak = hinf_norm(G)
    gains = np.linalg.norm(G.response(frequencies(G)), 2, axis=(1, 2))
    assert np.max(gains) <= peak.gain * (1.0 + ROUNDING)
    attained = np.linalg.norm(G.response(min(peak.omega, 1e12))[0], 2)
    assert abs(attained - peak.gain) <= 1e-6 * peak.gain  # the frequency is rounded where the peak is sharp


@settings(max_examples=30)
@given(stable_systems(), st.floats(0.01, 100.0))
def test_norms_scale_with_the_system(G, factor):
    scaled = series(G, gain(factor * np.eye(2), G.dt))
    assert np.isclose(hinf_norm(scaled).gain, factor * hinf_norm(G).gain, rtol=ROUNDING)
    assert np.isclose(h2_norm(scaled), factor * h2_norm(G), rtol=ROUNDING)


@settings(max_examples=30)
@given(stable_systems())
def test_the_norm_of_a_product_is_at_most_the_product_of_norms(G):
    assert hinf_norm(series(G, G)).gain <= hinf_norm(G).gain ** 2 * (1.0 + ROUNDING)
