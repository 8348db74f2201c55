"""The paper's numbers beside ours: what was printed, what the triangle inequality allows, what is missed."""

import csv

import numpy as np
import pytest

from problems import paper_figures as module

pytestmark = pytest.mark.opensim


@pytest.fixture(scope="module")
def simulations():
    return module.solve_simulations()


def test_the_papers_overall_means_follow_from_its_table():
    weights = np.array([module.TASK_WEIGHTS[key] for key, _ in module.PAPER_DIFFERENCE], dtype=float)
    means = weights @ np.array(list(module.PAPER_DIFFERENCE.values())) / weights.sum()
    # both the table and the means are rounded to one digit
    assert means == pytest.approx(module.PAPER_MEANS, abs=2 * 0.05)


def test_numbers_stated_for_the_reconstruction_come_out_again(simulations):
    bent, lifted = simulations
    rows = {(row.tasks, row.group, row.method): row for row in module.difference_rows(bent)}
    # RA and EO are silent under SO, so their change is their mean activation; stated to two or three digits
    for group, method, value in (("EO", "SCSO q = 5", 4.35), ("EO", "SCSO q = 3", 9.81),
                                 ("RA", "SCSO q = 5", 0.51), ("RA", "SCSO q = 3", 4.21)):  # fmt: skip
        assert rows["symmetric", group, method].change == pytest.approx(value, abs=0.006)
    for method, value in (("SCSO q = 5", 3.7), ("SCSO q = 3", 10.3)):
        assert rows["symmetric", "ES", method].change == pytest.approx(value, abs=0.06)
    assert module.critical_gain(lifted.problem) == pytest.approx(12.971, abs=6e-4)


def differences(bent, emg):
    """Difference from EMG of every method by tasks and group, laid out as the paper's table."""
    found = {}
    for tasks, group in module.PAPER_DIFFERENCE:
        frames, sides = module._SIDES[tasks]
        activations = [bent.group(method, group, sides)[frames] for method in module.METHODS]
        measured = emg(activations[0])
        found[tasks, group] = tuple(float(np.abs(a - measured).mean()) for a in activations)
    return found


@pytest.mark.parametrize("level", [5.0, 40.0])
def test_the_bounds_hold_for_any_emg(simulations, rng, monkeypatch, level):
    """If the paper's numbers came from our activations and whatever EMG, they would lie within the bounds."""
    bent, _ = simulations
    for _ in range(20):
        table = differences(bent, lambda plain: rng.uniform(0, level, plain.shape))
        monkeypatch.setattr(module, "PAPER_DIFFERENCE", table)
        rows = module.difference_rows(bent)
        assert len(rows) == 2 * len(table)
        # the inequality is exact, so only round-off may pass
        assert all(row.low - 1e-12 <= row.paper <= row.high + 1e-12 for row in rows)
        assert all(row.is_possible for row in rows)


def test_the_bounds_are_no_wider_than_they_must_be(simulations, monkeypatch):
    """EMG equal to SO leaves no room; silent EMG reaches the upper bound, EMG above both the lower one."""
    bent, _ = simulations
    tables = [differences(bent, emg) for emg in (lambda plain: plain, np.zeros_like, lambda a: 0 * a + 100)]
    monkeypatch.setattr(module, "PAPER_DIFFERENCE", tables[0])
    assert all(row.low == row.paper == row.high for row in module.difference_rows(bent))
    for table, bound in zip(tables[1:], ("high", "low"), strict=True):
        monkeypatch.setattr(module, "PAPER_DIFFERENCE", table)
        # silent under SO, so that they can only rise
        rows = [row for row in module.difference_rows(bent) if row.group in ("RA", "EO")]
        assert [row.paper for row in rows] == pytest.approx([getattr(row, bound) for row in rows], abs=1e-3)
        assert max(row.change for row in rows) > 5


def test_the_disagreements_are_said(simulations):
    bent, lifted = simulations
    impossible = {
        (row.tasks, row.group, row.method)
        for row in module.difference_rows(bent)
        if not row.is_possible and row.group in ("RA", "EO")
    }
    assert impossible == {("asymmetric, right side", "EO", "SCSO q = 5")}
    assert module._least_ratio_error(lifted, 4.5) > 3 * module.PAPER_RATIO[4.5][1]


def test_the_critical_gain_separates_so_from_scso(simulations):
    _, lifted = simulations
    critical = module.critical_gain(lifted.problem)
    above, below = module.sweep(lifted.problem, (critical + 0.05, critical - 0.5))
    plain = lifted.solutions["SO"].activation
    # an interior-point answer to 1e-6 of the objective
    assert above.activation == pytest.approx(plain, abs=1e-4)
    assert np.abs(below.activation - plain).max() > 1e-3


def test_gains_without_an_answer_are_softened_and_say_what_is_missed(simulations):
    bent, _ = simulations
    low, high = module.sweep(bent.problem, (1.0, 1.5))
    # five tasks have no answer at q = 1, three of them postures; all tasks have one at 1.5
    assert (low.missed > 0).sum() == 3
    assert (high.missed == 0).all()
    assert (high.objective <= low.objective + 1e-6)[low.missed == 0].all()


def test_one_command_writes_figures_tables_and_text(tmp_path, simulations, monkeypatch):
    monkeypatch.setattr(module, "solve_simulations", lambda: simulations)
    monkeypatch.setattr(module, "SWEEP", (1.0, 5.0))
    monkeypatch.setattr(module.sweep, "__defaults__", ((1.0, 5.0),))
    module.write_paper_figures(tmp_path / "out")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    pictures = {name for name in written if name.endswith(".png")}
    assert len(pictures) == 8
    assert written == {
        "README.md", "activations.csv", "differences.csv", "eigenvalues.csv", "sweep.csv",
        *pictures, *(name.replace(".png", ".pdf") for name in pictures),
    }  # fmt: skip
    text = (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    assert "**Where the\nnumbers agree, that is by construction.**" in text
    assert "negative in\n54 of 54 answers" in text
    with open(tmp_path / "out" / "differences.csv", encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == 24
