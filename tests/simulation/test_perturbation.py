"""Perturbations. Truth: the ranges of the protocol, MuJoCo's compiled bodies."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from wbmpc.errors import InputError
from wbmpc.robots import load_description, load_spec
from wbmpc.simulation.any_perturbation import AnyPerturbation, models
from wbmpc.simulation.perturbation import Perturbation, perturbation_model, quantize

BODIES = [b.name for b in load_spec(load_description("swerve-ur10")).bodies if b.name != "world"]


def draws(count: int, **settings):
    p = AnyPerturbation(**settings)
    return [p.draw(np.random.default_rng(k), BODIES, 4, 6) for k in range(count)]


def test_draws_fill_their_ranges():
    many = draws(200)

    def span(values) -> tuple[float, float]:
        flat = np.concatenate([np.ravel(v) for v in values])
        return float(flat.min()), float(flat.max())

    expected = {
        "mass": (span(list(d.mass.values()) for d in many), (0.95, 1.05)),
        "inertia": (span(list(d.inertia.values()) for d in many), (0.9, 1.1)),
        "com": (span(list(d.com.values()) for d in many), (-0.01, 0.01)),
        "friction": (span(d.friction for d in many), (0.6, 0.9)),
        "radius": (span(d.radius for d in many), (0.998, 1.002)),
        "leg": (span(d.mount_offset[0] for d in many), (-0.002, 0.002)),
        "arm": (span(d.arm_offset for d in many), (-0.002, 0.002)),
        "steer": (span(d.mount_offset[1] for d in many), (-0.003, 0.003)),
        "lag": (span([*d.wheel_lag, *d.mount_lag, *d.arm_lag] for d in many), (0.014, 0.026)),
    }
    for name, ((low, high), (least, maximum)) in expected.items():
        width = maximum - least
        assert least <= low < least + 0.05 * width, name
        assert maximum - 0.05 * width < high <= maximum, name


def test_radii_differ_wheel_by_wheel_and_a_common_factor_is_a_setting_of_its_own():
    assert all(np.ptp(d.radius) > 0.0 for d in draws(5))
    common = list(draws(5, wheel_radius_each=0.0, wheel_radius=0.002))
    assert all(np.ptp(d.radius) == 0.0 and d.radius[0] != 1.0 for d in common)


def test_bodies_change_as_drawn_and_balanced_ones_keep_their_center():
    description = load_description("swerve-ur10")
    nominal, spec = load_spec(description).compile(), load_spec(description)
    draw = draws(1)[0]
    draw.apply_to_bodies(spec, balanced=("wheel_LF",))
    changed = spec.compile()
    for name in BODIES:
        b = nominal.body(name).id
        assert changed.body_mass[b] == pytest.approx(draw.mass[name] * nominal.body_mass[b])
        if nominal.body_mass[b] > 0.0:
            assert changed.body_inertia[b] == pytest.approx(draw.inertia[name] * nominal.body_inertia[b])
            moved = changed.body_ipos[b] - nominal.body_ipos[b]
            assert moved == pytest.approx(np.zeros(3) if name == "wheel_LF" else draw.com[name], abs=1e-15)
            quat = nominal.body_iquat[b] @ changed.body_iquat[b]
            assert abs(quat) == pytest.approx(1.0)


def test_every_field_can_be_zero_and_none_is_the_model():
    zero = AnyPerturbation(**dict.fromkeys(AnyPerturbation.model_fields.keys() - {"brake_fault", "drives"}, 0))
    draw = zero.draw(np.random.default_rng(0), BODIES, 4, 6)
    assert set(draw.mass.values()) == {1.0} and not np.any(list(draw.com.values())) and draw.friction == 0.0
    none = Perturbation.none(mass=0.01)
    assert (none.mass, none.com_offset, none.actuator_time_constant, none.friction) == (0.01, 0.0, 0.02, (0.8, 0.8))


def test_what_bases_of_one_size_share_is_drawn_alike():
    """Whatever spreads their models have: experiments and seeds stay comparable, and old runs can be run again."""
    drawn = [kind().draw(np.random.default_rng(3), BODIES, 4, 6) for kind in (Perturbation, *models())]
    for draw in drawn[1:]:
        assert (draw.mass, draw.friction, draw.downhill) == (drawn[0].mass, drawn[0].friction, drawn[0].downhill)
        np.testing.assert_array_equal(draw.arm_lag, drawn[0].arm_lag)


def test_a_plant_takes_what_its_own_model_has():
    description, kind = load_description("panda"), perturbation_model("fixed")
    given = AnyPerturbation(mass=0.2, brake_delay=0.0, payload=1.0)
    assert kind.of(given, description) == kind(mass=0.2, payload=1.0) and kind.of(None, description) == kind()
    with pytest.raises(
        InputError, match=r"plant\.slope: .*'panda' \(base type 'fixed'\) does not read it; valid: .*payload"
    ):
        kind.of(AnyPerturbation(slope=0.1), description)


def test_friction_may_be_one_number():
    assert Perturbation(friction=0.6).friction == (0.6, 0.6)


@pytest.mark.parametrize(
    "bad", [{"masss": 0.1}, {"mass": -0.1}, {"friction": (0.9, 0.6)}, {"actuator_time_constant": np.nan}]
)
def test_bad_settings_are_rejected(bad):
    with pytest.raises(ValidationError):
        Perturbation(**bad)


def test_quantization_is_within_half_a_count():
    angles = np.random.default_rng(0).uniform(-10, 10, 1000)
    step = 2 * np.pi / 2**14
    read = quantize(angles, 2**14)
    assert np.abs(read - angles).max() <= step / 2 + 1e-12
    assert read / step == pytest.approx(np.round(read / step), abs=1e-6)
    assert quantize(angles, 0) is angles


def test_specifications_are_fresh_for_every_plant():
    description = load_description("rezero")
    first, second = load_spec(description), load_spec(description)
    first.body("base").mass = 1.0
    assert isinstance(first, mujoco.MjSpec) and second.body("base").mass == pytest.approx(18.66)
