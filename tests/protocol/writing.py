"""Protocols as a test writes them: a head that is in order, and the steps that matter."""

from pathlib import Path

from leactl import yamlfile
from leactl.protocol.plan import Segment
from leactl.protocol.protocolfile import expand_document

HEAD_LINES = 8


def text(*steps, rate_Hz=100, parameters="{}", conditions="{}", more="", mode="{test: current, load: velocity}"):  # noqa: N803
    """A protocol; its first step (line 8) engages the drives, so that the first of `steps` stands in line 9."""
    head = [
        "name: trial",
        "setup: coupled",
        f"rate_Hz: {rate_Hz}",
        f"parameters: {parameters}",
        f"conditions: {conditions}",
        more,
        "steps:",
        f"  - mode: {mode}",
    ]
    return "\n".join([*head, *(f"  - {step}" for step in steps)]) + "\n"


def read(source, folder=Path(), condition="", **overrides):
    """The plan of a protocol's text."""
    return expand_document(yamlfile.parse(source, "trial.yaml"), folder, overrides, condition)


def plan(*steps, folder=Path(), condition="", overrides=None, **head):
    """The plan of some steps."""
    return read(text(*steps, **head), folder, condition, **(overrides or {}))


def segments(found):
    """The plan's segments alone."""
    return [action for action in found.actions if isinstance(action, Segment)]


def levels(found, name="hold"):
    """The setpoint of the test actuator in every segment of this name."""
    return [segment.setpoints["test"].at(0.0) for segment in segments(found) if segment.name == name]
