"""Reports: the statistics against enumeration, tables and curves by hand, broken studies."""

from __future__ import annotations

import csv
import itertools
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from deep.__main__ import main
from deep.runs.folder import versions
from deep.study.figures import (
    COLORS,
    STYLES,
    ablation_figure,
    epsilon_figure,
    evaluation_returns,
    interventions,
    total_violations,
    training_figure,
    violation_share,
)
from deep.study.paper_results import PAPER_TASKS, PaperScore, paper_score
from deep.study.report import report
from deep.study.saved_runs import METHODS, Study, read_study
from deep.study.statistics import Estimate, band, estimate
from deep.study.tables import ablation_table, epsilon_table, main_table, plug_table, seed_rows
from tests.deep import studies

STEPS = studies.STEPS


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with every section on two tasks, WCSAC missing on the second."""
    folder: Path = tmp_path_factory.mktemp("whole") / "study"
    studies.write_study(folder, ("static-env", "point-goal1"), seeds=4)
    return folder


@pytest.fixture(scope="module")
def reported(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of that study, while one of its runs was not finished."""
    later = whole / "static-env/train/later"
    later.mkdir()
    out = tmp_path_factory.mktemp("reported") / "out"
    report(whole, out)
    later.rmdir()
    return out


def _rows(table: str, heading: str) -> dict[str, list[str]]:
    """The cells of the rows below a heading, by their first cell."""
    lines = table.split(f"### {heading}\n")[1].split("\n###")[0].splitlines()
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines if "|" in line]
    return {row[0]: row[1:] for row in cells}


# Statistics


def test_iqm_drops_a_quarter_at_either_end() -> None:
    assert estimate([1.0, 2.0, 5.0, 100.0]).value == 3.5
    assert estimate([8.0, 0.0, 4.0]).value == 4.0  # nothing to drop: the plain mean
    assert estimate([5.0, 1.0, 2.0, 3.0, 90.0]).value == pytest.approx(10 / 3)
    assert estimate([0, 0, 2, 4, 4, 4, 4, 10, 100, 100]).value == pytest.approx(28 / 6)
    assert estimate([0, 1, 2, 3], [10, 11, 12, 13]).value == (2 + 3 + 10 + 11) / 4


def test_interval_is_that_of_all_resamples() -> None:
    values = np.array([1.0, 2.0, 4.0, 9.0])
    resamples = np.sort([values[list(draw)] for draw in itertools.product(range(4), repeat=4)])
    exact = np.sort(resamples[:, 1:3].mean(axis=1))  # all 256 of them
    found = estimate(values.tolist())
    assert found.low is not None
    assert found.high is not None
    # 2000 draws place the quantiles within one percent of their rank.
    assert np.quantile(exact, 0.015) <= found.low <= np.quantile(exact, 0.035)
    assert np.quantile(exact, 0.965) <= found.high <= np.quantile(exact, 0.985)
    assert found == estimate(values.tolist())


def test_one_seed_has_no_interval_and_equal_seeds_one_of_no_width() -> None:
    assert estimate([3.0]) == Estimate(3.0, None, None)
    assert estimate([3.0], [4.0, 5.0]).low is None
    assert estimate([0.5, 0.5, 0.5, 0.5]) == Estimate(0.5, 0.5, 0.5)


def test_tasks_are_resampled_apart() -> None:
    assert estimate([0.0] * 4, [1.0] * 4) == Estimate(0.5, 0.5, 0.5)
    together = estimate([*[0.0] * 4, *[1.0] * 4])
    assert (together.low, together.high) == (0.0, 1.0)


def test_band_is_the_estimate_at_each_step_with_gaps() -> None:
    values = np.array([[1.0, 5.0, 0.0], [2.0, np.nan, 0.0], [4.0, 5.0, 1.0], [9.0, 5.0, 3.0]])
    found = band(values)
    assert np.isnan([found.value[1], found.low[1], found.high[1]]).all()
    for column in (0, 2):
        alone = estimate(values[:, column].tolist())
        assert (found.value[column], found.low[column], found.high[column]) == (
            alone.value,
            alone.low,
            alone.high,
        )
    single = band(np.array([[1.0, 2.0]]))
    assert single.value.tolist() == [1.0, 2.0]
    assert np.isnan(single.low).all()


# The paper's numbers


def test_paper_has_45_cells() -> None:
    pairs = [f"{policy}+{form}" for policy in ("sac", "iql") for form in METHODS]
    cells = {(task, name) for task in PAPER_TASKS for name in (*METHODS, *pairs)}
    found = {cell for cell in cells if paper_score(*cell)}
    assert len(found) == 5 * 5 + 5 * 4
    assert paper_score("point-goal1", "dea-rrl") == PaperScore(14.079, 0.035, tv=236)
    assert paper_score("doggo-goal1", "sac") == PaperScore(16.956, 0.908, tv=31450)
    assert paper_score("dynamic-env", "iql+dea-rrl") == PaperScore(19.425, 0.078, arr=0.235)
    assert paper_score("real:static-env", "sac") == paper_score("static-env", "sac")
    assert paper_score("brake", "sac") is None
    assert paper_score("static-env", "dea-rrl-annealed") is None


# Tables


def test_main_table_by_hand(tmp_path: Path) -> None:
    seeds = [
        studies.seed_result(k, acr=a, avr=0.25, tv=t, arr=0.1, training_arr=0.2, threshold=0.3)
        for k, a, t in ((0, 1.0, 900), (1, 2.0, 1000), (2, 4.0, 1400), (3, 9.0, 9000))
    ]
    studies.write_result(tmp_path / "point-goal1/train/dea-rrl", "point-goal1", "dea-rrl", seeds)
    rows = _rows(main_table(read_study(tmp_path)), "point-goal1")
    acr, acr_paper, avr, avr_paper, tv, tv_paper, *rest = rows["DEA-RRL"]
    assert acr.split(" ")[0] == "3.00"
    assert tv.split(" ")[0] == "1,200"
    interval = estimate([900, 1000, 1400, 9000])
    assert tv == f"1,200 [{interval.low:,.0f}, {interval.high:,.0f}]"
    assert (avr, acr_paper, avr_paper, tv_paper) == ("0.250", "14.079", "0.035", "236")
    budget = ["4", "1,000,000", "100,000", "500", "1 h 7 min"]
    assert rest == ["0.100", "0.200", "0.3", *budget]
    assert rows["SAC"][:6] == ["missing", "12.609", "missing", "0.753", "missing", "12,375"]
    assert rows["DEARRL (IQL)"][:2] == ["missing", "–"]
    assert "0.000" not in rows["SAC"]


def test_one_seed_shows_no_interval(tmp_path: Path) -> None:
    studies.write_result(tmp_path / "brake/train/sac", "brake", "sac", [studies.seed_result(7)])
    row = _rows(main_table(read_study(tmp_path)), "brake")["SAC"]
    assert row[:6] == ["10.00", "–", "0.100", "–", "100", "–"]
    assert row[9] == "1"


def test_all_tasks_together_in_units_of_sac(tmp_path: Path) -> None:
    for task, unit in (("static-env", 1.0), ("point-goal1", 10.0)):
        for method, share in (("sac", 1.0), ("rrl", 0.5)):
            seeds = [
                studies.seed_result(k, acr=share * unit, tv=int(share * 10 * unit))
                for k in range(4)
            ]
            studies.write_result(tmp_path / task / "train" / method, task, method, seeds)
    rows = _rows(main_table(read_study(tmp_path)), "All tasks together")
    assert rows["RRL"][:3] == ["0.50", "0.100", "0.500"]
    assert rows["RRL"][-1] == "8"
    assert rows["WCSAC"][:3] == ["missing"] * 3
    assert "Over static-env, point-goal1.\n" in main_table(read_study(tmp_path))
    again = [studies.seed_result(0, acr=100.0)]
    studies.write_result(tmp_path / "real/train/sac", "real:static-env", "sac", again)
    assert _rows(main_table(read_study(tmp_path)), "All tasks together") == rows
    one_task = replace(read_study(tmp_path), runs=read_study(tmp_path).runs[:2])
    assert "All tasks" not in main_table(one_task)


def test_no_share_of_a_sac_that_gains_nothing(tmp_path: Path) -> None:
    for task, reward in (("static-env", 0.0), ("point-goal1", 10.0)):
        seeds = [studies.seed_result(0, acr=reward)]
        studies.write_result(tmp_path / task / "train/sac", task, "sac", seeds)
    rows = _rows(main_table(read_study(tmp_path)), "All tasks together")
    assert rows["SAC"][:3] == ["–", "0.100", "1.000"]


def test_plug_table(whole: Path) -> None:
    rows = _rows(plug_table(read_study(whole)), "point-goal1")
    assert rows["SAC with DEA-RRL"][1::2][:3] == ["10.596", "0.000", "0.275"]
    assert rows["SAC with DEA-RRL"][4].split(" ")[0] == "0.215"  # of 0.20, 0.21, 0.22, 0.23
    assert rows["SAC with DEA-RRL (annealed)"][0] == "missing"
    assert rows["IQL alone"][:4] == ["13.50 [12.00, 15.00]", "12.740", "0.500", "0.760"]


def test_ablation_and_epsilon_tables(whole: Path) -> None:
    study = read_study(whole)
    rows = _rows(ablation_table(study), "static-env")
    assert list(rows)[2:] == [
        *("RRL", "RRL (MSDP)", "DEARRL (IQL)", "DEA-RRL", "DEA-RRL (annealed)")
    ]
    assert rows["RRL"][5] == "0.7"
    lines = [line for line in epsilon_table(study).splitlines() if line.startswith("| DEA-RRL |")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [row[1] for row in cells] == ["0.05", "0.1", "0.3", "0.5", "0.7"] * 2
    assert [row[-1] for row in cells] == ["", "", "yes", "", ""] * 2
    run = study.section("select")["static-env", "dea-rrl"]
    assert [row[4] for row in cells[:5]] == [str(seed.tv) for seed in run.seeds]


# Curves


def _little_run(folder: Path) -> Study:
    """Two seeds, four rows of progress, the second longer than the others."""
    place = folder / "static-env/train/rrl"
    seeds = [studies.seed_result(k, threshold=0.3) for k in (3, 5)]
    studies.write_result(place, "static-env", "rrl", seeds)
    header = ("step", "seed", "episodes", "violations", "interventions")
    rows = [
        (10, 3, 0, 0, 0.5), (10, 5, 1, 1, 0.1),
        (40, 3, 4, 1, 0.1), (40, 5, 2, 1, 0.2),
        (50, 3, 6, 2, 0.0), (50, 5, 4, 3, 0.0),
        (60, 3, 8, 2, 1.0), (60, 5, 8, 4, 0.4),
    ]  # fmt: skip
    studies.write_log(place / "progress.csv", header, rows)
    evaluations = [(30, 3, 1.0, 0.5, 0.1), (30, 5, 3.0, 0.5, 0.1), (60, 5, 7.0, 0.5, 0.1)]
    columns = ("step", "seed", "acr", "avr", "arr")
    studies.write_log(place / "evaluations.csv", columns, evaluations)
    return read_study(folder)


def test_curves_by_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (run,) = _little_run(tmp_path).runs
    share = violation_share(run)
    assert share is not None
    assert share.steps.tolist() == [10, 40, 50, 60]
    expected = [[np.nan, 1 / 4, 1 / 2, 0.0], [1.0, 0.0, 1.0, 1 / 4]]
    np.testing.assert_array_equal(share.values, expected)
    monkeypatch.setattr("deep.study.figures.BINS", 2)  # bins end at steps 40 and 60
    share = violation_share(run)
    assert share is not None
    assert share.steps.tolist() == [40, 60]
    np.testing.assert_array_equal(share.values, [[1 / 4, 1 / 4], [1 / 2, 3 / 6]])
    corrected = interventions(run)
    assert corrected is not None
    expected = [[(5 + 3) / 40, 10 / 20], [(1 + 6) / 40, 4 / 20]]
    np.testing.assert_allclose(corrected.values, expected, rtol=1e-12)
    total = total_violations(run)
    assert total is not None
    assert total.values.tolist() == [[0, 1, 2, 2], [1, 1, 3, 4]]
    returns = evaluation_returns(run)
    assert returns is not None
    np.testing.assert_array_equal(returns.values, [[1.0, np.nan], [3.0, 7.0]])


def test_without_logs_or_filter_there_is_no_curve(whole: Path) -> None:
    runs = read_study(whole).section("train")
    offline = runs["static-env", "iql"]
    assert evaluation_returns(offline) is None
    assert violation_share(offline) is None
    assert total_violations(offline) is None
    assert interventions(offline) is None
    assert interventions(runs["static-env", "sac"]) is None


def test_an_offline_log_is_not_read(tmp_path: Path) -> None:
    place = tmp_path / "static-env/train/iql"
    studies.write_result(place, "static-env", "iql", [studies.seed_result(0)])
    (place / "progress.csv").write_text("update,loss\n")
    assert read_study(tmp_path).runs[0].progress is None
    assert len(training_figure(read_study(tmp_path)).axes) == 4


# Figures


def test_training_figure_holds_the_curves(whole: Path) -> None:
    study = read_study(whole)
    figure = training_figure(study)
    assert len(figure.axes) == 4 * 2
    returns, second, _, _, total, _, corrected, _ = figure.axes
    assert (returns.get_title(), second.get_title()) == ("static-env", "point-goal1")
    lines = {str(line.get_label()): line for line in returns.get_lines()}
    assert list(lines) == [method for method in METHODS if method != "iql"]
    run = study.section("train")["static-env", "rrl"]
    assert run.evaluations is not None
    ours = np.sort(run.evaluations.columns["acr"], axis=0)[1:3].mean(axis=0)
    np.testing.assert_allclose(lines["rrl"].get_ydata(), ours, rtol=1e-12)
    assert lines["rrl"].get_xdata().tolist() == run.evaluations.steps.tolist()
    for axes in figure.axes:
        assert all(
            to_rgb(line.get_color()) == to_rgb(COLORS[str(line.get_label())])
            for line in axes.get_lines()
        )
    assert "wcsac" not in [line.get_label() for line in second.get_lines()]
    assert [text.get_text() for text in second.texts] == ["missing: WCSAC"]
    assert not returns.texts
    assert (total.get_yscale(), returns.get_yscale()) == ("symlog", "linear")
    assert {line.get_label() for line in corrected.get_lines()} == set(studies.CHARACTER) - {
        *("sac", "wcsac")
    }


def test_training_figure_band_spans_the_interval(whole: Path) -> None:
    study = read_study(whole)
    run = study.section("train")["static-env", "sac"]
    assert run.evaluations is not None
    across = band(run.evaluations.columns["acr"])
    polygon = training_figure(study).axes[0].collections[0].get_paths()[0].vertices
    ends = {float(y) for y in np.asarray(polygon)[:, 1]}
    assert set(across.low.tolist()) | set(across.high.tolist()) <= ends


def test_legend_lies_below_the_panels(whole: Path) -> None:
    figure = training_figure(read_study(whole))
    figure.canvas.draw()
    (legend,) = figure.legends
    top = legend.get_window_extent().y1
    assert all(top <= axes.get_window_extent().y0 for axes in figure.axes)
    assert [text.get_text() for text in legend.get_texts()] == [
        label for method, label in METHODS.items() if method != "iql"
    ]


def test_real_tasks_follow_the_others_in_the_same_order(tmp_path: Path) -> None:
    ordered = ("static-env", "dynamic-env", "point-goal1", "real:static-env", "real:point-goal1")
    for task in sorted(ordered):
        place = tmp_path / task.replace(":", "-") / "train" / "sac"
        studies.write_result(place, task, "sac", [studies.seed_result(0)])
    assert read_study(tmp_path).tasks() == ordered


def test_what_is_missing_stands_outside_the_panels(tmp_path: Path) -> None:
    tasks = ("static-env", "dynamic-env", "point-goal1", "real:point-goal1", "real:static-env")
    for k, task in enumerate(tasks):
        results = [studies.seed_result(0)]
        place = tmp_path / task.replace(":", "-") / "train"
        for method in ("sac", list(METHODS)[1:][k]):  # every method on one task only
            studies.write_result(place / method, task, method, results)
    figure = training_figure(read_study(tmp_path))
    figure.canvas.draw()
    first = figure.axes[:5]
    notes = [axes.texts[0].get_window_extent() for axes in first]
    for k, (axes, note) in enumerate(zip(first, notes, strict=True)):
        assert note.y0 >= axes.get_window_extent().y1
        assert note.y1 <= axes.title.get_window_extent().y0
        assert not any(note.overlaps(other) for other in notes[:k])
    lines = first[0].texts[0].get_text().replace("\N{NO-BREAK SPACE}", " ").splitlines()
    assert lines == ["missing: RRL, RRL (MSDP),", "DEA-RRL, DEA-RRL (annealed)"]


def test_returns_have_a_scale_of_their_own(whole: Path) -> None:
    for figure in (training_figure(read_study(whole)), epsilon_figure(read_study(whole))):
        shared = [
            left.get_shared_y_axes().joined(left, right)
            for left, right in zip(figure.axes[::2], figure.axes[1::2], strict=True)
        ]
        assert shared == [False, True, True, True]
        assert [axes.get_yscale() for axes in figure.axes[4:6]] == ["symlog", "symlog"]
        point = [axes.transData.transform((0.1, 100.0))[1] for axes in figure.axes[4:6]]
        assert point[0] == pytest.approx(point[1])


def test_no_two_methods_look_the_same_in_grey() -> None:
    weights = np.array([0.2126, 0.7152, 0.0722])
    looks = [
        (STYLES.get(method, "-"), float(weights @ to_rgb(COLORS[method])))
        for method in METHODS
        if method != "iql"
    ]
    for (style, grey), (other, light) in itertools.combinations(looks, 2):
        assert style != other or abs(grey - light) > 0.1


def test_ablation_and_epsilon_figures(whole: Path) -> None:
    study = read_study(whole)
    assert [line.get_label() for line in ablation_figure(study).axes[0].get_lines()] == [
        *("rrl", "rrl-msdp", "dearrl-iql", "dea-rrl", "dea-rrl-annealed")
    ]
    figure = epsilon_figure(study)
    total = figure.axes[4]
    lines = {str(line.get_label()): line for line in total.get_lines()}
    assert list(lines) == ["rrl", "rrl-msdp", "dearrl-iql", "dea-rrl", "dea-rrl-annealed"]
    run = study.section("select")["static-env", "dea-rrl"]
    assert lines["dea-rrl"].get_xydata().tolist() == [
        [seed.threshold, seed.tv] for seed in run.seeds
    ]
    rings = [found for found in total.collections if found.get_sizes().tolist() == [90]]
    assert [ring.get_offsets().tolist() for ring in rings][3] == [[0.3, run.seeds[2].tv]]
    assert total.get_ylim()[1] > max(seed.tv or 0 for seed in run.seeds)


# The whole report


def test_report_writes_everything(whole: Path, reported: Path) -> None:
    found = read_study(whole)
    tables = ("main", "plug_and_play", "ablation_pretraining", "ablation_epsilon")
    pictures = {"training.png", "ablation_pretraining.png", "ablation_epsilon.png"}
    files = {f"{name}{suffix}" for name in tables for suffix in (".md", ".csv")} | pictures
    assert {path.name for path in reported.iterdir()} == files | {*("report.md", "report.json")}
    page = (reported / "report.md").read_text()
    assert all(f"]({name})" in page for name in pictures)
    assert "Not finished, and so not in here: `static-env/train/later`." in page
    assert main_table(found) in page
    inventory = json.loads((reported / "report.json").read_text())
    assert [run["folder"] for run in inventory["runs"]] == [run.folder for run in found.runs]
    assert inventory["runs"][0]["made with"] == studies.MADE_WITH
    assert inventory["unfinished"] == ["static-env/train/later"]
    assert inventory["report made with"]["git"] == versions()["git"]
    assert {"matplotlib", "numpy", "scipy", "python"} <= set(inventory["report made with"])


def test_csv_round_trip(whole: Path, reported: Path) -> None:
    study = read_study(whole)
    with (reported / "main.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    runs = study.section("train")
    assert (
        len(rows)
        == sum(len(run.seeds) for run in runs.values())
        == len(seed_rows(study, "train")) - 1
    )
    for row in rows:
        run = runs[row["task"], row["method"]]
        (seed,) = [seed for seed in run.seeds if seed.seed == int(row["seed"])]
        assert (float(row["acr"]), float(row["avr"]), int(row["tv"])) == (
            seed.acr,
            seed.avr,
            seed.tv,
        )
        assert (float(row["threshold"]) if row["threshold"] else None) == seed.threshold
        assert (row["run"], row["git"]) == (run.folder, "a" * 40)
        assert (whole / row["run"] / "result.json").is_file()


def test_missing_parts_say_so_and_leave_no_old_files(
    reported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, out = tmp_path / "study", tmp_path / "out"
    shutil.copytree(reported, out)
    studies.write_result(study / "brake/train/sac", "brake", "sac", [studies.seed_result(0)])
    assert main(["report", "--study", str(study), "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}/report.md: 1 finished runs, 0 unfinished\n"
    names = {path.name for path in out.iterdir()}
    assert names == {"main.md", "main.csv", "training.png", "report.md", "report.json"}
    page = (out / "report.md").read_text()
    for section in ("plug", "ablation", "select"):
        assert f"Missing: no finished run in `<task>/{section}/`." in page


# Broken studies


def _exactly(message: str) -> str:
    return f"^{re.escape(message)}$"


def test_a_report_lies_in_a_folder_of_its_own(whole: Path, tmp_path: Path) -> None:
    before = sorted(whole.rglob("*"))
    for inside in (whole, whole / "report", whole / "static-env" / ".." / "page"):
        with pytest.raises(
            ValueError, match="is in the study .*, which is only read: give another"
        ):
            report(whole, inside)
    assert sorted(whole.rglob("*")) == before
    (tmp_path / "main.md").write_text("mine")
    with pytest.raises(ValueError, match="holds something else than a report: give a new folder"):
        report(whole, tmp_path)
    assert (tmp_path / "main.md").read_text() == "mine"


def test_command_names_a_broken_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "study/brake/train/sac"
    place.mkdir(parents=True)
    (place / "result.json").write_text('{"task": "br')
    assert main(["report", "--study", str(tmp_path / "study"), "--out", str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"deep: {place / 'result.json'}: not a readable JSON file (")


BROKEN = [
    ({"acr": "ten"}, "'seeds': 'acr' must be a number, not 'ten'"),
    ({"acr": True}, "'seeds': 'acr' must be a number, not True"),
    ({"acr": float("nan")}, "'seeds': 'acr' must be finite, not nan"),
    ({"avr": 1.5}, "'seeds': 'avr' must be in [0, 1], not 1.5"),
    ({"threshold": -0.1}, "'seeds': 'threshold' must be at least 0, not -0.1"),
    ({"tv": -1}, "'seeds': 'tv' must be a count, not -1"),
    ({"tv": 1.5}, "'seeds': 'tv' must be a count, not 1.5"),
]


@pytest.mark.parametrize(("change", "sentence"), BROKEN)
def test_wrong_values_are_named(tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    place = tmp_path / "brake/train/sac"
    studies.write_result(place, "brake", "sac", [studies.seed_result(0, **change)])
    with pytest.raises(ValueError, match=_exactly(f"{place / 'result.json'}, {sentence}")):
        read_study(tmp_path)


def test_wrong_structure_is_named(tmp_path: Path) -> None:
    place = tmp_path / "brake/train/sac"
    studies.write_result(place, "brake", "sac", [studies.seed_result(0)])
    path = place / "result.json"
    whole = json.loads(path.read_text())
    changes = [
        ({"seeds": []}, ": seeds must be there, and none twice"),
        ({"seeds": whole["seeds"] * 2}, ": seeds must be there, and none twice"),
        ({"seeds": 3}, ": 'seeds' must be a list, not 3"),
        ({"task": None}, ": 'task' must be a string, not None"),
        ({"budget": 5}, ", 'budget': expected an object, not 5"),
        ({"budget": {"wall_seconds": 1}}, ", 'budget': 'evaluation_episodes' is missing"),
    ]
    for change, sentence in changes:
        path.write_text(json.dumps(whole | change))
        with pytest.raises(ValueError, match=_exactly(f"{path}{sentence}")):
            read_study(tmp_path)
    path.write_text("[1]")
    with pytest.raises(ValueError, match=r"result.json: expected an object, not \[1\]"):
        read_study(tmp_path)


LOGS = [
    ("step,seed,episodes,violations\n", ": no column interventions"),
    ("step,seed,episodes,violations,interventions\n10,0,1,x,0\n", ", line 2: not a row of numbers"),
    ("step,seed,episodes,violations,interventions\n10,0,1\n", ", line 2: not a row of numbers"),
    (
        "step,seed,episodes,violations,interventions\n10,4,1,1,0\n",
        ", line 2: step 10 of seed 4 is there twice or the result has no such seed",
    ),
    (
        "step,seed,episodes,violations,interventions\n10,0,1,1,0\n10,0,1,1,0\n",
        ", line 3: step 10 of seed 0 is there twice or the result has no such seed",
    ),
]


@pytest.mark.parametrize(("text", "sentence"), LOGS)
def test_broken_logs_are_named(tmp_path: Path, text: str, sentence: str) -> None:
    place = tmp_path / "brake/train/sac"
    studies.write_result(place, "brake", "sac", [studies.seed_result(0)])
    (place / "progress.csv").write_text(text)
    with pytest.raises(ValueError, match=_exactly(f"{place / 'progress.csv'}{sentence}")):
        read_study(tmp_path)


def test_an_empty_log_is_no_curve(tmp_path: Path) -> None:
    place = tmp_path / "brake/train/sac"
    studies.write_result(place, "brake", "sac", [studies.seed_result(0)])
    (place / "progress.csv").write_text("step,seed,episodes,violations,interventions\n")
    assert read_study(tmp_path).runs[0].progress is None


def test_studies_without_runs_or_with_doubles(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nowhere: there is no such folder"):
        read_study(tmp_path / "nowhere")
    (tmp_path / "brake/train/sac").mkdir(parents=True)
    with pytest.raises(ValueError, match=r"no finished run \(no <task>/<train\|plug"):
        read_study(tmp_path)
    for name in ("one", "two"):
        place = tmp_path / "brake/train" / name
        studies.write_result(place, "brake", "sac", [studies.seed_result(0)])
    with pytest.raises(
        ValueError, match="brake/train/one and brake/train/two are both a run of sac on brake"
    ):
        read_study(tmp_path)
