"""Names of vector entries. Truth: the order in which they were given."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.model.layout import Layout

LAYOUT = Layout({"base": ["x", "y", "yaw"], "arm": ["shoulder", "elbow"]})


def test_slices_names_and_places() -> None:
    assert LAYOUT["base"] == slice(0, 3)
    assert LAYOUT["arm"] == slice(3, 5)
    assert LAYOUT.size == 5
    assert LAYOUT.names == ("base.x", "base.y", "base.yaw", "arm.shoulder", "arm.elbow")
    assert [LAYOUT.index(n) for n in LAYOUT.names] == list(range(5))


def test_vector_and_split_are_inverse() -> None:
    x = LAYOUT.vector({"arm": [4.0, 5.0]}, default=1.0)
    np.testing.assert_array_equal(x, [1, 1, 1, 4, 5])
    np.testing.assert_array_equal(LAYOUT.vector(LAYOUT.split(x)), x)
    np.testing.assert_array_equal(LAYOUT.vector({"base": 2.0}), [2, 2, 2, 0, 0])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: LAYOUT["amr"], ("'amr'", "did you mean 'arm'", "base, arm")),
        (lambda: LAYOUT.index("arm.elbo"), ("'arm.elbo'", "did you mean 'arm.elbow'")),
        (lambda: LAYOUT.vector({"leg": [0.0]}), ("'leg'", "valid: base, arm")),
        (lambda: LAYOUT.vector({"arm": [0.0, 1.0, 2.0]}), ("'arm'", "2", "3")),
        (lambda: LAYOUT.split([0.0, 1.0]), ("5", "(2,)")),
    ],
)
def test_wrong_names_and_sizes_are_named(call, words) -> None:
    with pytest.raises(InputError) as error:
        call()
    assert all(w in str(error.value) for w in words), str(error.value)


def test_layouts_compare_by_names() -> None:
    assert Layout({"arm": ["a"]}) == Layout({"arm": ("a",)})
    assert Layout({"arm": ["a"]}) != Layout({"arm": ["b"]})
