"""Units given element by element reach the model description, or are refused."""

from __future__ import annotations

import build_extra  # noqa: F401
import fmpy
import modelica_bench as bench
import pytest

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import build

MODEL = """model Model
input Real u[2](unit={UNITS}, each start=0);
output Real y[2](start={{1, 2}}, unit={{"m", "rad"}}, each fixed=true);
output Real z(unit="m");
equation
der(y[1]) = u[1]; der(y[2]) = u[2]; z = y[1];
end Model;
"""


def test_each_element_has_its_unit(tmp_path):
    path = bench.model_file(tmp_path, MODEL.format(UNITS='{"m/s", "rad/s"}'))
    build(path, tmp_path / "Model.fmu", platforms=[])
    units = {
        one.name: one.unit
        for one in fmpy.read_model_description(str(tmp_path / "Model.fmu"), validate=False).modelVariables
    }
    assert [units[name] for name in ("u[1]", "u[2]", "y[1]", "y[2]", "z")] == [
        "m/s",
        "rad/s",
        "m",
        "rad",
        "m",
    ]


@pytest.mark.parametrize("given", ['{"m"}', '{"m", "m", "m"}'])
def test_a_list_of_another_length_is_refused(given, tmp_path):
    path = bench.model_file(tmp_path, MODEL.format(UNITS=given))
    with pytest.raises(BuildError) as caught:
        build(path, tmp_path / "Model.fmu", platforms=[])
    assert str(caught.value).splitlines()[0] == (
        f'{path}:2:7: unit of u has to be one text, or one for each of its 2 elements: {{"m", "rad"}}'
    )
