"""The table of a replay and what its rows mean, from the data of replay.json."""

from collections.abc import Mapping
from typing import Any

from relloc_env.numerals import number
from relloc_env.replay.bound import BOUND


def table(data: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Heads and cells, one row per estimator."""
    estimators, bounded = data["estimators"], data["bound"] == BOUND
    poses = any(part["pose"] for part in estimators.values())
    heads = ["estimator", "tracks", "initial depth error [m]", "final depth error [m]"]
    heads += ["the same where sure [m] (tracks)", "time to 10 % of the error [s] (tracks)"]
    if poses:
        heads += ["seconds with an estimate", "position error [m]", "its RMS [m]", "heading error [deg]"]
        heads += ["its RMS [deg]", "NEES"]
    heads += ["error / bound"] if bounded else []
    rows = []
    for name, part in estimators.items():
        depth, pose = part["depth"], part["pose"] or {}
        row = [
            name,
            str(depth["tracks"]),
            number(depth.get("median_initial_error_m"), 2, error="m"),
            number(depth.get("median_final_error_m"), 2, error="m"),
            f"{number(depth.get('median_final_error_where_sure_m'), 3, error='m')} ({depth.get('sure_tracks', 0)})",
            f"{number(depth.get('median_time_to_10_percent_s'), 1)} ({depth.get('settled_tracks', 0)})",
        ]
        if poses:
            row += [
                f"{pose.get('seconds_with_estimate', 0)} of {pose.get('seconds_with_two_common_points', 0)}",
                number(pose.get("median_position_error_m"), 2, error="m"),
                number(pose.get("rmse_position_m"), 2, error="m"),
                number(pose.get("median_heading_error_deg"), 1),
                number(pose.get("rmse_heading_deg"), 1),
                number(pose.get("median_nees"), 1),
            ]
        if bounded:
            row.append(number(pose.get("whitened_error") if poses else depth.get("whitened_final_error"), 2))
        rows.append(row)
    return heads, rows


def notes(data: Mapping[str, Any]) -> list[str]:
    """What the rows mean, for beside the table."""
    parts, needed = list(data["estimators"].values()), data["estimate_exists_below"]
    words = [f"Warning: {words}." for words in data["warnings"]]
    words += [
        "Errors are medians over tracks, and over seconds with an estimate. In brackets: how many tracks.",
        f"Sure: at the end of the track, to a claimed standard deviation of {data['depth_sure_below_sd_m']} m.",
    ]
    if any(part["pose"] for part in parts):
        words += [
            f"An estimate: claimed to {needed['position_sd_m']} m and {needed['heading_sd_rad']} rad.",
            "Seconds: of those with two points in both maps; each direction of a pair has its own.",
            f"NEES: {data['nees_median_expected']:.1f} is right.",
        ]
    if any(part["pose"] or part["depth"]["tracks"] for part in parts):
        words.append(f"Error / bound: {BOUND}." if data["bound"] == BOUND else f"No error / bound: {data['bound']}.")
    return words
