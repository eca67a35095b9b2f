"""The noise is what it claims to be: normal, white, independent, the seed's."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import load_model
from scipy import stats


def drawn(seed, number=20000, **parameters):
    model = load_model("SensorNoise").SensorNoise(instance_name="noise")
    settings = {"seed": seed, "sample_period": 1e-3, "force_sigma": 2.0, "torque_sigma": 0.1, **parameters}
    for name, value in settings.items():
        setattr(model, name, value)
    model.setup_experiment(0.0, None, None)
    model.exit_initialization_mode()
    found = [model.values]
    for index in range(number - 1):
        assert model.do_step(index * 1e-3, 1e-3)
        found.append(model.values)
    return np.array(found) / ([settings["force_sigma"]] * 3 + [settings["torque_sigma"]] * 3)


def test_it_is_normal_white_and_independent():
    values = drawn(1)
    number = len(values)
    for channel in values.T:
        assert stats.kstest(channel, "norm").pvalue > 0.01
        lagged = np.corrcoef(channel[:-1], channel[1:])[0, 1]
        assert abs(lagged) < 4.0 / np.sqrt(number)
    between = np.corrcoef(values.T) - np.eye(6)
    assert np.abs(between).max() < 4.0 / np.sqrt(number)


def test_seeds_differ_and_repeat():
    first, again, other = drawn(5, 2000), drawn(5, 2000), drawn(6, 2000)
    assert (first == again).all()
    assert abs(np.corrcoef(first[:, 0], other[:, 0])[0, 1]) < 0.1


def test_values_are_held_between_samples():
    values = drawn(3, 100, sample_period=4e-3)
    changes = np.flatnonzero((np.diff(values, axis=0) != 0.0).any(axis=1)) + 1
    assert changes.tolist() == list(range(4, 100, 4))


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"seed": 0}, "noise: seed is 0; allowed: 1 to 2147483398"),
        ({"sample_period": 0.0}, "noise: sample_period is 0.0 s; allowed: finite, above 0 s"),
        ({"force_sigma": -1.0}, "noise: force_sigma is -1.0 N; allowed: finite, not negative"),
        ({"torque_sigma": -1.0}, "noise: torque_sigma is -1.0 N.m; allowed: finite, not negative"),
    ],
)
def test_refusals(parameters, text):
    with pytest.raises(ValueError) as caught:
        drawn(**{"seed": 1, "number": 2, **parameters})
    assert str(caught.value) == text
