"""``python -m dead_ends.visualize``: pictures, numbers and errors, as a user meets them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib import pyplot
from PIL import Image

from dead_ends.cli import visualize
from dead_ends.visualize import main

SMALL_BRAKE = ["brake", "--distance", "60", "--speed", "10"]
MAGIC = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.mark.parametrize("suffix", MAGIC)
def test_the_suffix_is_the_format(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"picture{suffix}"
    assert main([*SMALL_BRAKE, "--out", str(path)]) == 0
    assert path.read_bytes().startswith(MAGIC[suffix])
    assert list(tmp_path.iterdir()) == [path]


def test_the_numbers_of_the_brake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Counted by hand: 61 + 3 distances, 11 speeds, stopping distances 0 0 0 0 1 2 3 5 7 9 12."""
    path = tmp_path / "brake.png"
    main([*SMALL_BRAKE, "--out", str(path), "--gamma-safe", "0.5"])
    rows = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert rows["states"] == str(64 * 11)
    assert rows["|S_fail|"] == str(3 * 11)
    assert rows["|S_dead|"] == str(1 + 2 + 3 + 5 + 7 + 9 + 12)
    assert rows["|S_safe|"] == str(61 * 11 - 39)
    assert rows["H"] == "3"
    assert rows["H_b"] == "3"
    assert rows["threshold"] == "0 < epsilon_safe <= gamma_safe**3 = 0.125"
    assert rows["picture"] == str(path)


def test_the_other_dynamics_have_other_dead_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Moving before braking, the car needs its speed more to stop."""
    main([*SMALL_BRAKE, "--dynamics", "explicit", "--out", str(tmp_path / "a.png")])
    rows = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert rows["|S_dead|"] == str(39 + sum(range(11)))


@pytest.mark.parametrize("task", ["gridworld", "lifegate", "bridge"])
def test_maps_and_animations(tmp_path: Path, task: str) -> None:
    picture, animation = tmp_path / "map.png", tmp_path / "map.gif"
    assert main([task, "--out", str(picture), "--gif", str(animation)]) == 0
    assert picture.stat().st_size > 10_000
    with Image.open(animation) as image:
        assert image.n_frames > 5


def test_exactly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In fractions the same pictures, and thresholds that are no floats."""
    rounded, exact = tmp_path / "rounded.png", tmp_path / "exact.png"
    brake = [*SMALL_BRAKE, "--gamma-safe", "0.1"]
    assert main([*brake, "--out", str(rounded)]) == main([*brake, "--exact", "--out", str(exact)])
    assert "gamma_safe**3 = 1/1000\n" in capsys.readouterr().out
    assert rounded.read_bytes() == exact.read_bytes()
    gif = ["bridge", "--gamma-safe", "1", "--exact", "--gif", str(tmp_path / "a.gif")]
    assert main([*gif, "--out", str(exact)]) == 0


def test_a_threshold_that_is_no_float_needs_exactness(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = ["--out", str(tmp_path / "a.png"), "--gif", str(tmp_path / "a.gif")]
    tiny = ["gridworld", "--gamma-safe", "1e-200", *paths]
    assert main(tiny) == 2
    assert "which is smaller than every float: use --exact\n" in capsys.readouterr().err
    assert main([*tiny, "--exact"]) == 0


def test_a_map_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "map.png"
    text.write_text("S.>L\n")
    assert main(["gridworld", "--map", str(text), "--out", str(text)]) == 2
    assert "map.png: is read as input" in capsys.readouterr().err
    assert text.read_text() == "S.>L\n"


def test_a_users_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "map.txt"
    text.write_text("S.>L\n")
    assert main(["gridworld", "--map", str(text), "--out", str(tmp_path / "map.svg")]) == 0
    rows = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert (rows["|S_fail|"], rows["|S_dead|"], rows["|S_safe|"]) == ("1", "1", "2")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["brake", "--out", "brake.jpg"], "--out: brake.jpg must end in .png, .svg, .pdf"),
        (["brake", "--gif", "brake.mp4"], "--gif: brake.mp4 must end in .gif"),
        (["brake", "--gamma-safe", "1.5"], "--gamma-safe must lie in (0, 1], not 1.5"),
        (["brake", "--braking", "0"], "max_braking must be at least 1, not 0"),
        (["gridworld", "--slip", "2"], "slip must lie in 0 to 1, not 2.0"),
        (["gridworld", "--map", "missing.txt"], "visualize: missing.txt: No such file"),
        ([*SMALL_BRAKE, "--out", "nowhere/a.png"], "the folder nowhere does not exist"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"S.\n.?\n", "row 1, column 1 of the map: unknown cell '?'"),
        (b"\xff\xfe", "'utf-8' codec can't decode byte 0xff"),
    ],
)
def test_a_bad_map_is_named(
    content: bytes, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "map.txt"
    path.write_bytes(content)
    assert main(["gridworld", "--map", str(path), "--out", str(tmp_path / "map.png")]) == 2
    assert capsys.readouterr().err.startswith(f"dead_ends.visualize: {path}: {message}")
    assert list(tmp_path.iterdir()) == [path]


def test_without_a_display_a_file_is_written_here(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")
    } | {"PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-m", "dead_ends.visualize", "gridworld"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1].split() == ["picture", "gridworld.png"]
    assert (tmp_path / "gridworld.png").exists()


def test_with_a_display_the_picture_is_in_its_window(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(visualize, "_has_display", lambda: True)
    shown = []
    monkeypatch.setattr(pyplot, "show", lambda: shown.append(pyplot.gcf()))
    assert main(SMALL_BRAKE) == 0
    (figure,) = shown
    assert figure.canvas.manager is not None
    assert len(figure.axes) > 0
    assert capsys.readouterr().out.splitlines()[-1].split() == ["picture", "in", "its", "window"]
    assert not list(tmp_path.iterdir())
    pyplot.close(figure)
