"""The page about a model, driven in a real browser as a reader would."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dead_ends import SafeMDP, classify, evaluate_policy, value_iteration
from dead_ends.__main__ import main
from dead_ends.cli.page_answers import MAX_STATES, page_answers
from dead_ends.draw.page import draw_page, layout_by_survival_time
from dead_ends.envs.brake import BrakeLattice, brake, late_braker
from dead_ends.envs.lifegate import lifegate
from dead_ends.io.npz import save_npz
from dead_ends.model.digest import model_digest
from dead_ends.paper import conservatism
from dead_ends.safety.critics import unguarded

LATTICE = BrakeLattice(max_distance=60, max_speed=10, obstacle_depth=3)
BROWSER_OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1250,1000",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("the page was not tried: no chromium and chromedriver here")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in BROWSER_OPTIONS:
        options.add_argument(option)
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('browser')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    session = webdriver.Chrome(options, webdriver.ChromeService(driver))
    yield session
    session.quit()


def page_of(model: SafeMDP, title: str, policies: Any = None) -> str:
    return draw_page(model, page_answers(model, policies), title)


def open_page(browser: Any, path: Path, page: str) -> Any:
    path.write_text(page, encoding="utf-8")
    browser.get(path.as_uri())
    assert browser.get_log("browser") == []
    return lambda name: browser.find_element("id", name)


def gate_counts(find: Any) -> list[tuple[int, int]]:
    cells = [c.text.split(" of ") for c in find("gate").find_elements("css selector", ".number")]
    return [(int(part), int(whole)) for part, whole in cells]


def test_the_gate_on_the_page_is_the_gate_of_the_library(browser: Any, tmp_path: Path) -> None:
    model = brake(LATTICE)
    policy = late_braker(LATTICE, 15)
    find = open_page(browser, tmp_path / "brake.html", page_of(model, "brake", {"late": policy}))
    critics = {
        "best policy, Q*": value_iteration(model, 0.99),
        "late": evaluate_policy(model, policy, 0.99),
    }
    horizon = classify(model).boundary_horizon
    assert horizon is not None
    for name, critic in critics.items():
        find("critic").send_keys(name)
        for epsilon in (0.99**horizon, np.nextafter(0.99**horizon, 1), 0.3):
            box = find("epsilonValue")
            box.clear()
            box.send_keys(f"{float(epsilon)!r}\n")
            count = conservatism(model, unguarded(critic.Q), epsilon)
            assert gate_counts(find) == [
                (count.blocked_safe_actions, count.safe_actions),
                (count.missed_unsafe_actions, count.unsafe_actions),
                (count.blocked_safe_states, count.safe_states),
            ]


def test_the_sliders_move_the_gate(browser: Any, tmp_path: Path) -> None:
    find = open_page(browser, tmp_path / "brake.html", page_of(brake(LATTICE), "brake"))
    exact = gate_counts(find)
    assert (exact[0][0], exact[1][0]) == (0, 0)
    find("epsilon").send_keys("\ue010")  # End: epsilon 1
    assert float(find("epsilonValue").get_attribute("value")) == 1
    assert gate_counts(find)[1][0] > 0
    find("gamma").send_keys("\ue011")  # Home: the least gamma
    assert find("gammaValue").text == "0.5"
    find("exact").click()
    assert float(find("epsilonValue").get_attribute("value")) == 0.5**3
    assert [count[0] for count in gate_counts(find)] == [0, 0, 0]


def test_a_click_shows_the_witness(browser: Any, tmp_path: Path) -> None:
    model = brake(LATTICE)
    find = open_page(browser, tmp_path / "brake.html", page_of(model, "brake"))
    assert find("digest").text == model_digest(model)
    dead = LATTICE.state(6, 9)
    point = browser.execute_script(f"return centre({dead})")
    canvas = find("picture")
    size = canvas.size
    from selenium.webdriver import ActionChains

    ActionChains(browser).move_to_element_with_offset(
        canvas, point[0] - size["width"] / 2, point[1] - size["height"] / 2
    ).click().perform()
    assert int(find("state").get_attribute("value")) == dead
    assert "within 2 steps" in find("witness").text
    assert find("name").text == model.state_names[dead]
    safe = find("state")
    safe.clear()
    safe.send_keys(f"{LATTICE.state(60, 0)}\n")
    assert find("witness").text.startswith("Safe: -6 m/s² leads to safe states only")


def test_stochastic_models_and_models_without_geometry(browser: Any, tmp_path: Path) -> None:
    model = lifegate()
    find = open_page(browser, tmp_path / "lifegate.html", page_of(model, "LifeGate"))
    assert "56" in find("numbers").text
    browser.execute_script("select(88)")
    assert find("witness").text.startswith("Dead-end: every successor of every action is dead")
    browser.execute_script("select(30)")
    assert find("witness").text.startswith("At risk: within")
    plain = SafeMDP.deterministic([[1, 2], [3, 3], [2, 0], [3, 3]], np.arange(4) == 3)
    find = open_page(browser, tmp_path / "plain.html", page_of(plain, "</script><b>plain"))
    assert find("title").text == "</script><b>plain"
    browser.execute_script("select(1)")
    assert "state 1 → state 3" in find("witness").text


def test_the_page_needs_no_network() -> None:
    page = page_of(lifegate(), "LifeGate")
    assert "http:" not in page
    assert "https:" not in page
    assert "src=" not in page


def test_the_layout_gives_every_state_a_cell_of_its_own() -> None:
    labelling = classify(brake(LATTICE))
    cells = layout_by_survival_time(labelling).cell
    assert len(np.unique(cells, axis=0)) == len(cells)
    last_dead = cells[labelling.dead, 0].max()
    assert cells[labelling.fail, 0].max() < cells[labelling.dead, 0].min()
    assert last_dead < cells[labelling.safe, 0].min()


def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, policy, page = tmp_path / "m.npz", tmp_path / "lazy.npy", tmp_path / "m.html"
    save_npz(brake(LATTICE), model)
    np.save(policy, np.zeros(LATTICE.shape[0] * LATTICE.shape[1], dtype=int))
    assert main(["page", str(model), "--out", str(page), "--policy", str(policy)]) == 0
    assert '"name":"lazy"' in page.read_text()
    policy.write_text("no policy")
    assert main(["page", str(model), "--out", str(page), "--policy", str(policy)]) == 2
    assert f"{policy}: not a policy in .npy form" in capsys.readouterr().err
    assert main(["page", str(model), "--out", str(tmp_path / "m.txt")]) == 2
    assert "the page is written as .html" in capsys.readouterr().err


def test_a_model_too_large_for_a_page_is_refused() -> None:
    size = MAX_STATES + 1
    model = SafeMDP.deterministic(np.zeros((size, 1), dtype=np.int32), np.zeros(size, dtype=bool))
    with pytest.raises(ValueError, match="the page shows at most 100,000 states"):
        page_answers(model)


def test_what_is_no_guarantee_and_no_float_is_said(browser: Any, tmp_path: Path) -> None:
    """An estimate in which 1,100 steps pass before failure: 0.5**1100 is no float."""
    n = 1100
    after = np.minimum(np.arange(n + 2) + 1, n + 1)
    table = np.stack([after, np.where(np.arange(n + 2) == 0, 0, after)], axis=1)
    model = SafeMDP.deterministic(table, np.arange(n + 2) == n + 1)
    find = open_page(browser, tmp_path / "a.html", page_of(model, "corridor"))
    assert "estimate" not in find("subtitle").text
    find("gamma").send_keys("\ue011")  # Home: the least gamma
    assert "which is smaller than every float" in find("exact").text
    assert not find("exact").is_enabled()
    estimate = replace(model, estimate=True)
    find = open_page(browser, tmp_path / "a.html", page_of(estimate, "corridor"))
    assert "The model is an estimate from a log" in find("subtitle").text
