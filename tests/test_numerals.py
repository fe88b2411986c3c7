"""How tables write numbers: the same function in the demonstration, replays, and the benchmark's page."""

import math

import pytest

from agents.report.cells import cell
from agents.report.columns import MADE, MOVED, Figure
from relloc_env.numerals import FAR, number
from relloc_env.replay.report import table


@pytest.mark.parametrize(
    ("value", "options", "text"),
    [
        (1.234, {}, "1.23"),
        (-1.234, {"sign": True}, "−1.23"),
        (1.234, {"sign": True}, "+1.23"),
        (342.398, {}, "342"),
        (111461.9, {}, "1e5"),
        (None, {}, "–"),
        (math.nan, {"error": "m"}, "–"),
        (math.inf, {}, "never"),
        (9.994, {"error": "m"}, "9.99"),
        (342.398, {"error": "m"}, "> 10 m"),
        (math.inf, {"error": "m"}, "> 10 m"),
        (99.0, {"error": "%"}, "99.00"),
        (101.0, {"error": "%"}, "> 100 %"),
        (342.398, {"error": "°"}, "342"),
    ],
)
def test_number(value, options, text):
    assert number(value, 2, **options) == text


@pytest.mark.parametrize("column", [c for c in (*MADE, *MOVED) if c.unit in FAR], ids=lambda c: c.key)
def test_report_writes_no_meaningless_error(column):
    text = cell(Figure(342.398, 300.0, 400.0), column).text
    assert text.startswith("> ") == (column in MADE)


def test_replay_writes_no_meaningless_error():
    depth = {"tracks": 1, "median_initial_error_m": 1.0, "median_final_error_m": 342.398, "sure_tracks": 0}
    pose = {"median_position_error_m": 15.84, "rmse_position_m": 9.0, "median_heading_error_deg": 44.4}
    data = {"estimators": {"cascade": {"depth": depth, "pose": pose}}, "bound": "none"}
    heads, (row,) = table(data)
    shown = dict(zip(heads, row, strict=True))
    assert shown["final depth error [m]"] == shown["position error [m]"] == "> 10 m"
    assert (shown["its RMS [m]"], shown["heading error [deg]"]) == ("9.00", "44.4")
