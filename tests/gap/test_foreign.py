"""Recordings of real machines with published results: import by mapping file, then the equations against what is known.

EMPS (nonlinearbenchmark.org, 2019), LAAS anti-cogging (2023) and Better Actuator Models' XL330 (2026).
"""

from pathlib import Path

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose, read_case
from leactl.gap.equations import equations
from leactl.gap.search.angle_periodogram import strongest_orders
from leactl.gap.search.effect_regression import PRIORS
from leactl.gap.search.regression import Normal, make_rows, residuals, stack
from leactl.gap.servo.effect_sets import fit_effect_sets
from leactl.gap.servo.runs import servo_runs
from leactl.gap.servo.simulation import replay, table
from leactl.gap.signals.record import read_record
from leactl.gap.signals.smoothing import smoothed_and_thinned
from leactl.model.nominal import read_model
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.read.reader import Run

FILES = Path(__file__).parent / "foreign"
NO_PRIORS = dict.fromkeys(PRIORS, np.inf)


def imported(name, pattern, folder):
    """Run files of one set; skips where the recordings are not at hand."""
    sets = [parent.parent / "shared" / "gap-real" / name for parent in Path(__file__).resolve().parents]
    source = next((place for place in sets if place.is_dir()), None)
    if source is None:
        pytest.skip(f"the {name} recordings (../shared/gap-real) are not on this machine")
    return import_runs([str(source / pattern)], FILES / f"{name}_map.yaml", folder)


def nominal(name):
    return read_model(FILES / f"{name}_model.yaml")[0]


def rows_of(records, model, hypothesis=()):
    made = [rows for r in records for rows in make_rows(r.name, r.kind, equations(r, model), hypothesis)]
    return [rows for rows in made if rows is not None]


def fitted(rows, hypothesis=(), priors=PRIORS):
    stacked = stack(rows, priors)
    weights = [1.0 / np.var(r.left_over) for r in rows]
    for _ in range(3):
        normal = Normal(stacked, weights)
        fit = normal.fit(hypothesis)
        weights = [normal.residual_rms(fit, index) ** -2 for index in range(len(rows))]
    values = {stacked.names[k]: v for k, v in zip(fit.columns, fit.values, strict=True)}
    return normal, fit, values


def test_emps_has_its_published_parameters(tmp_path):
    (file,) = imported("emps", "*.mat", tmp_path)
    model, record, offset = nominal("emps"), read_record(file), [("asymmetric_friction", ())]
    (rows,) = rows_of([record], model, offset)
    assert (rows.equation, rows.units) == ("axis_torque", "N")
    normal, fit, found = fitted([rows], offset, NO_PRIORS)
    relative = {name: found["calibration", name] for name in ("rotor_inertia", "viscous_damping", "coulomb_friction")}
    assert abs(relative["rotor_inertia"]) < 0.01
    assert abs(relative["viscous_damping"]) < 0.05
    assert abs(relative["coulomb_friction"]) < 0.05
    force = model.coulomb_friction * found["effect", "asymmetric_friction", "()", "asymmetry"]
    assert force == pytest.approx(-3.1648, abs=0.3)
    left = residuals(normal.stack, fit, 0)
    whole = rows.left_over + sum(column for name, column in rows.columns.items() if name[0] == "calibration")
    assert np.linalg.norm(left) / np.linalg.norm(whole) == pytest.approx(0.04, abs=0.005)


def test_emps_is_diagnosed_with_its_offset_as_one_class(tmp_path):
    (file,) = imported("emps", "*.mat", tmp_path)
    diagnosis = diagnose(read_case([file], [], FILES / "emps_model.yaml"))
    assert [c.effect for c in diagnosis.causes if c.probability > 0.5 and not c.indistinguishable_from] == []
    assert {c.effect for c in diagnosis.causes} == {"asymmetric_friction", "current_sensor_offset"}
    assert {diagnosis.causes[0].effect, *diagnosis.causes[0].indistinguishable_from} == {
        c.effect for c in diagnosis.causes
    }
    offset = next(c for c in diagnosis.causes if c.effect == "current_sensor_offset").parameters[0]
    assert offset.value == pytest.approx(-3.1648, abs=0.4)
    relative = {line.parameter: line.fitted / line.nominal - 1.0 for line in diagnosis.calibration}
    assert abs(relative["rotor_inertia"]) < 0.01
    (equation,) = equations(read_record(file), nominal("emps"))
    columns = equation.calibration | {"offset": np.ones_like(equation.left_over)}
    changes = relative | {"offset": offset.value}
    force = equation.left_over + sum(equation.calibration.values())
    left = equation.left_over - sum(change * columns[name] for name, change in changes.items())
    table = smoothed_and_thinned(np.stack([left, force], axis=1), equation.width, equation.step)
    moving = smoothed_and_thinned(equation.mask.astype(float), equation.width, equation.step) > 0.999
    assert np.linalg.norm(table[moving, 0]) <= 0.040 * np.linalg.norm(table[moving, 1])


def test_laas_cogging_is_found_on_one_half_and_holds_on_the_other(tmp_path):
    files = {file.stem.split("-")[-1]: file for file in imported("laas_cogging", "stopped_data.csv", tmp_path)}
    model, forward = nominal("laas_cogging"), read_record(files["forward"])
    normal, fit, _ = fitted(rows_of([forward], model))
    orders = [form[0] for effect, form in strongest_orders(normal.stack, fit, normal.weights, 6) if effect == "cogging"]
    assert orders[0] == 72
    assert residual_current(files["reverse"], model, forward, (), -1) > 0.13
    assert residual_current(files["reverse"], model, forward, (72.0,), -1) < 0.055
    assert residual_current(files["reverse"], model, forward, tuple(orders), -1) < 0.029


def residual_current(file, model, forward, orders, sense):
    """Root mean square of a run's current, sample by sample, minus what another run's fit makes of its angle."""
    hypothesis = [("cogging", orders)] if orders else []
    _, _, found = fitted(rows_of([forward], model, hypothesis), hypothesis)
    with Run.open(file) as run:
        angle, current = run.channel("angle").values, run.channel("q_axis_current").values
    torque = sense * model.coulomb_friction * (1 + found["calibration", "coulomb_friction"])
    for place, order in enumerate(orders):
        further = f"_{order:g}" if place else ""
        cosine, sine = (found["effect", "cogging", repr(orders), name + further] for name in ("cos", "sin"))
        torque = torque - cosine * np.cos(order * angle) - sine * np.sin(order * angle)
    return float(np.sqrt(np.mean((current - torque / model.torque_constant) ** 2)))


@pytest.mark.parametrize("folder", ["processed", "raw"])
def test_xl330_friction_grows_with_load(tmp_path, folder):
    records = [read_record(file) for file in imported("bam_xl330", f"{folder}/*.json", tmp_path)]
    assert sorted({record.setup["drive_gain"] for record in records}) == pytest.approx(
        [1.8204, 3.6408, 7.2816, 14.5632]
    )
    model, pair = nominal("bam_xl330"), [("load_dependent_friction", (0.0,)), ("saturation", (1.0, 2.0))]
    rows = rows_of(records, model, pair)
    assert {r.equation for r in rows} == {"axis_torque"}
    assert "share one scale" in records[0].notes[-1]
    left = []
    for hypothesis in ([], pair[:1], pair):
        normal, fit, found = fitted(rows, hypothesis)
        left.append(np.sqrt(np.mean([normal.residual_rms(fit, index) ** 2 for index in range(len(rows))])))
    assert left[1] < 0.85 * left[0]
    assert left[2] < 0.75 * left[1]
    assert found["effect", "load_dependent_friction", "(0.0,)", "coefficient"] > 0.1


def mean_absolute_error(runs, parameters):
    return np.abs(replay(runs, table([parameters]))[0] - runs.angle)[runs.measured].mean()


@pytest.mark.long
def test_xl330_free_runs_at_a_gain_left_out(tmp_path):
    model = nominal("bam_xl330")
    records = [read_record(file) for file in imported("bam_xl330", "processed/*.json", tmp_path)]
    errors, standing = [], []
    for gain in sorted({record.setup["drive_gain"] for record in records}):
        others = [record for record in records if record.setup["drive_gain"] != gain]
        left_out = [record for record in records if record.setup["drive_gain"] == gain]
        result = fit_effect_sets(others, left_out, model, [])
        tried = (result.calibrated, result.augmented)
        errors.append([mean_absolute_error(servo_runs(left_out, model), item.parameters) for item in tried])
        standing.append({item.effect for item in result.standing if item.probability > 0.5})
    calibrated, augmented = np.mean(errors, axis=0)
    assert augmented <= 0.040
    assert augmented < 0.65 * calibrated
    assert all({"load_dependent_friction", "saturation"} <= names for names in standing)


@pytest.mark.long
def test_xl330_friction_falls_with_speed_where_it_grows_with_load(tmp_path):
    records = [read_record(file) for file in imported("bam_xl330", "processed/*.json", tmp_path)]
    result = fit_effect_sets(records, [], nominal("bam_xl330"), [("position_dependent_friction", (7.0,))])
    assert {item.effect: item.probability > 0.9 for item in result.standing} == {
        "load_dependent_friction": True,
        "saturation": True,
        "stribeck": True,
    }
    together = result.sets[frozenset({"load_dependent_friction", "saturation"})].cost / result.augmented.cost
    alone = result.sets[frozenset()].cost / result.sets[frozenset({"stribeck"})].cost
    assert together > 1.3
    assert alone < 1.05  # Stribeck friction by itself gains nothing
