"""Probabilities of weighed squares. Truth: SciPy."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from wbmpc.bases.ball.filter import chi_square_gate, chi_square_tail


@given(st.integers(1, 12), st.floats(0.0, 60.0))
def test_the_tail(freedom: int, square: float) -> None:
    assert chi_square_tail(square, freedom) == pytest.approx(chi2.sf(square, freedom), rel=1e-9, abs=1e-300)


@given(st.integers(1, 12), st.floats(1e-12, 0.999))
def test_the_gate_is_exceeded_that_often(freedom: int, probability: float) -> None:
    assert chi_square_gate(freedom, probability) == pytest.approx(chi2.isf(probability, freedom), rel=1e-9)
