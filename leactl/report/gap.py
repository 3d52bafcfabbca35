"""A diagnosis as text, as JSON and as an augmented model file."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from leactl.errors import InputError
from leactl.gap.diagnosis import Cause, Diagnosis
from leactl.model.nominal import as_mapping

WORDS = {
    "none": "none: the model explains these runs",
    "calibration": "calibration: other parameters explain these runs; no effect is missing",
    "effect": "effect: the model lacks something that the library knows",
    "unknown": "unknown: a gap remains that no effect of the library explains",
}


def write_answers(answer: Diagnosis, json_out: Path | None, html: Path | None, model: Path | None) -> None:
    """Write what was asked for, each file whole or not at all.

    Raises
    ------
    InputError : a file exists already, or its folder does not.
    """
    files = [path for path in (json_out, html, model) if path is not None and path != Path("-")]
    faults = [f"{path}: exists already; nothing is overwritten" for path in files if path.exists()]
    faults += [f"{path}: no folder {path.parent}" for path in files if not path.parent.is_dir()]
    if faults:
        raise InputError(faults)
    if json_out is not None:
        text = json.dumps(answer.as_json(), indent=1, allow_nan=False) + "\n"
        if json_out == Path("-"):
            sys.stdout.write(text)
        else:
            publish(json_out, text)
    if model is not None:
        publish(model, yaml.safe_dump(as_mapping(answer.extra["augmented"]), sort_keys=False))
    if html is not None:
        from leactl.report.gap_page import page

        publish(html, page(answer))


def publish(path: Path, text: str) -> None:
    """Write beside and rename, so that no reader meets half a file."""
    beside = path.with_name(f".{path.name}.part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)


def print_diagnosis(answer: Diagnosis) -> None:
    """Print the answer for a terminal."""
    print("\n".join(lines(answer)))


def lines(answer: Diagnosis) -> list[str]:
    """The answer, line by line, within 80 columns where names allow."""
    out = [WORDS[answer.verdict], f"probability that something unexplained acts: {answer.unexplained_probability:.2f}"]
    if answer.where:
        out += ["", "where               nominal  calibrated       floor  units   region"]
        for item in answer.where:
            place = f"{item.quantity}, {item.mechanical}"
            region = ""
            if item.region is not None:
                r = item.region
                region = f"{r.variable} {r.low:.3g} to {r.high:.3g} {r.units} ({item.share:.0%})"
            rms = f"{item.nominal_rms:>10.4g} {item.calibrated_rms:>10.4g} {item.floor_rms:>10.4g}"
            out.append(f"  {place:<28} {rms}  {item.units:<6} {region}".rstrip())
    if answer.causes:
        out += ["", "causes"]
        for cause in answer.causes:
            out += cause_lines(cause)
    if answer.shrinkage:
        out += ["", "gap on held-out runs: calibrated, with the effect, floor; share closed (95 %)"]
        for s in answer.shrinkage:
            closed = "" if s.closed is None else f"{s.closed:.3f}"
            if s.closed_low is not None and s.closed_high is not None:
                closed += f" ({s.closed_low:.3f} to {s.closed_high:.3f})"
            rms = f"{s.calibrated_rms:>10.4g} {s.augmented_rms:>10.4g} {s.floor_rms:>10.4g}"
            out.append(f"  {s.quantity + ', ' + s.mechanical:<28} {rms} {s.units:<6} {closed}".rstrip())
    if answer.calibration:
        out += ["", "calibration"]
        for p in answer.calibration:
            out.append(f"  {p.parameter:<34} {p.nominal:>10.5g} -> {p.fitted:.5g} +- {p.std:.2g} {p.units}")
    out += [""] * bool(answer.notes) + [f"note: {note}" for note in answer.notes]
    return out


def cause_lines(cause: Cause) -> list[str]:
    """One cause with its parameters and its class."""
    found = [f"  {cause.probability:.2f}  {cause.effect}"]
    found += [f"          {p.name} = {p.value:.4g} +- {p.std:.2g} {p.units}".rstrip(" 1") for p in cause.parameters]
    if cause.indistinguishable_from:
        found.append(f"          these runs cannot tell it from {named(cause.indistinguishable_from)}")
    if cause.separating_experiment:
        found.append(f"          to separate: leactl run {cause.separating_experiment}")
    return found


def named(names: Sequence[str]) -> str:
    """Names in one line."""
    return ", ".join(names)
