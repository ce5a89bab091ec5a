"""`benchmarks.evaluate`: the metrics of each run as a table."""

import pytest

import benchmarks
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios

TASK = scenarios.get("servo-nominal").replace(duration=0.5)


def test_the_table_has_the_metrics_of_each_run():
    runs = benchmarks.evaluate("pid-flm", TASK, seeds=2, kp=50.0)
    assert runs.to_dict("records") == [
        {name: row[name] for name in runs.columns} for row in measure(rollout("pid-flm", TASK, [0, 1], {"kp": 50.0}))
    ]
    assert list(runs.index) == [0, 1]
    assert "overshoot_pct" not in runs.columns  # of steps
    assert list(benchmarks.evaluate("zero", TASK, seeds=[7]).index) == [7]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seeds": 0}, "seeds must be"),
        ({"k": 1.0}, "argument of pid-flm 'k'"),
        ({"scenario": "servo-nominl"}, "nominal"),
    ],
)
def test_a_mistake_is_named(given, message):
    with pytest.raises(ValueError, match=message):
        benchmarks.evaluate(**{"policy": "pid-flm", "scenario": TASK, **given})
